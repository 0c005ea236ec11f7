"""Clicks and drags on the photograph and on models in space: points of an axis, creases and marks, pulls."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from .drawing import WINDOW, Drawing, away_from, material_point
from .handle import away, pixels
from .session import Session

if TYPE_CHECKING:
    from .page import Page

NEAR = 9.0
"""How near a click is to what it means [screen px]."""


class Mouse:
    """What the mice of all windows do; one holds a point or a model at a time.

    Args:
        page: with the session and the tool in hand.
    """

    def __init__(self, page: Page):
        self.page = page
        self._held: tuple[int, int] | None = None
        """window and object of a pull."""
        self._dragged: tuple[int, int] | None = None
        """object and number of a point, -1 for the radius' handle."""
        self._painted: tuple[np.ndarray, set[tuple[int, int]]] | None = None
        """where a stroke is, and the nodes on its way."""
        self._models: dict[int, Any] = {}

    def listen(self, drawing: Drawing) -> None:
        """Listens to a new photograph."""
        self._held, self._dragged, self._painted, self._models = None, None, None, {}

        for v, picture in enumerate(drawing.pictures):
            picture.on_click(partial(self._clicked, v, False))
            picture.on_click(modifier="shift")(partial(self._clicked, v, True))
            picture.on_drag("left")(partial(self._dragged_over, v))

    async def _clicked(self, v: int, shift: bool, event: Any) -> None:
        if v == self.page.eye:
            self._click(event, shift)

    async def _dragged_over(self, v: int, event: Any) -> None:
        if v != self.page.eye:
            return
        start, end = (_on_photograph(event.client, p) for p in (event.start_position, event.end_position))
        if self.page.tool == "Draw":
            self._drag_point(event, start, end)
        elif self.page.tool == "Crease":
            self._paint(event, start, end)
        else:
            self._pull(event, start, end, None)

    def listen_to_models(self, drawing: Drawing) -> None:
        """Listens to models in space that are new."""
        for uid, model in drawing.in_space().items():
            if self._models.get(uid) is model:
                continue
            self._models[uid] = model

            @model.on_drag("left")
            async def _(event: Any, uid: int = uid) -> None:
                self._pull(event, np.array(event.start_position), np.array(event.end_position), uid)

    def _click(self, event: Any, shift: bool) -> None:
        origin, ray = np.array(event.ray_origin), np.array(event.ray_direction)
        place = (origin - ray * origin[2] / ray[2])[:2]
        near, page = _near(event.client), self.page
        if page.engine.frame > 0:
            page.tell("The first frame", "axes, creases, gaps and marks are its own; go back to it")
            return
        tool, view = page.tool, page.eye

        def do(session: Session) -> None:
            uid = page.chosen if page.chosen is not None else session.add()
            page.chosen = uid
            if tool == "Draw":
                points = session.axis(uid, view)
                hit = _nearest(points, place, near)
                if hit is None and self._on_handle(place, near):
                    session.set_radius(uid, None if shift else session.item(uid).table.get("radius"))
                elif shift and hit is not None:
                    session.remove_point(uid, hit, view)
                elif not shift and hit is None:
                    session.add_point(uid, place, _between(points, place, near), view)
            elif tool in ("Crease", "Gap"):
                session.break_at(uid, place, "tangent" if tool == "Crease" else "position", view)
            else:
                session.mark(uid, place, view)

        if tool in ("Draw", "Crease", "Gap", "Not here"):
            page.act(do)

    def _drag_point(self, event: Any, start: np.ndarray, end: np.ndarray) -> None:
        session, uid = self.page.session, self.page.chosen
        if session is None or uid is None:
            return
        if event.phase == "start":
            item = session.item(uid)
            points = [] if item.in_world else session.axis(uid, self.page.eye)
            near = 1.5 * _near(event.client)
            hit = _nearest(points, start, near)
            hit = -1 if hit is None and self._on_handle(start, near) else hit
            self._dragged = None if hit is None else (uid, hit)
        if self._dragged is not None and self._dragged[1] < 0:
            self._set_radius(session, self._dragged[0], end)
        elif self._dragged is not None:
            held = self._dragged
            self.page.act(lambda s: s.move_point(*held, end, self.page.eye))
        if event.phase == "end":
            self._dragged = None
            session.end_of_drag()

    def _on_handle(self, place: np.ndarray, near: float) -> bool:
        """Whether a place is at the handle of the chosen object's radius."""
        handle = self.page.handle()
        return handle is not None and float(np.linalg.norm(handle[1] - place)) <= near

    def _set_radius(self, session: Session, uid: int, place: np.ndarray) -> None:
        """The first tube is to reach from the axis to a place."""
        unit = pixels(session, uid, self.page.eye)
        if unit is not None:
            radius = max(away(np.array(session.axis(uid, self.page.eye)), place), 1.0) / unit
            self.page.act(lambda s: s.set_radius(uid, float(f"{radius:.4g}")))

    def _paint(self, event: Any, start: np.ndarray, end: np.ndarray) -> None:
        """A stroke over the chosen model: nodes on its way lose their rigidity."""
        page = self.page
        s = page.engine.snapshots.get(page.chosen or -1)
        if page.session is None or s is None or page.chosen is None or page.engine.frame > 0:
            return
        uid, view = page.chosen, page.session.views[page.eye]
        if event.phase == "start":
            self._painted = (start, set())
        if self._painted is None:
            return
        before, nodes = self._painted
        nx, ns = s.tube.shape[:2]
        for share in np.linspace(0, 1, 2 + int(np.linalg.norm(end - before) / 2)):
            x, along = material_point(s, away_from(s, view, before + share * (end - before)))
            nodes.add((round(x * nx) % nx, round(along * (ns - 1))))
        self._painted = (end, nodes)
        if event.phase == "end":
            page.act(lambda session: session.paint(uid, sorted(nodes)))
            page.session.end_of_drag()
            self._painted = None

    def _pull(self, event: Any, start: np.ndarray, end: np.ndarray, uid: int | None) -> None:
        """A drag: on the photograph, points (column, row); on a model in space, points in the viewer's space."""
        page = self.page
        if page.session is None or page.drawing is None or page.tool not in ("Pull", "Pin", "Push"):
            return
        anchor = end if uid is None else page.drawing.frame.world(end)
        if event.phase == "start" and self._held is None:
            found = self._grabbed(start, uid)
            if found is None:
                return
            self._held = (event.client_id, found[0])
            page.engine.grab(*found, anchor, push=page.tool == "Push", view=page.eye)
        if self._held is None or self._held[0] != event.client_id:
            return
        held = self._held[1]
        page.engine.drag(held, anchor)
        if event.phase == "end":
            self._held = None
            kept = page.tool == "Pin"
            page.engine.let_go(held, kept).add_done_callback(lambda made: page.record(held, made.result()))

    def _grabbed(self, place: np.ndarray, uid: int | None) -> tuple[int, tuple[float, float]] | None:
        """Which object is taken hold of, and where on it."""
        page = self.page
        assert page.session is not None and page.drawing is not None
        snapshots, view = page.engine.snapshots, page.session.views[page.eye]
        if uid is not None:
            s = snapshots.get(uid)
            at = page.drawing.frame.world(place)
            return None if s is None else (uid, material_point(s, np.linalg.norm(s.tube - at, axis=2)))
        gaps = {uid: away_from(s, view, place) for uid, s in snapshots.items()}
        if not gaps:
            return None
        nearest = min(gaps, key=lambda uid: gaps[uid].min())
        return nearest, material_point(snapshots[nearest], gaps[nearest])


def _on_photograph(client: viser.ClientHandle, point: Sequence[float]) -> np.ndarray:
    """Where the line from the eye through a point meets the photograph (column, row)."""
    eye = client.camera.position
    way = np.asarray(point) - eye
    return (eye + way * (-eye[2] / way[2] if abs(way[2]) > 1e-9 else 1.0))[:2]


def _near(client: viser.ClientHandle) -> float:
    """`NEAR` in pixels of the photograph."""
    camera = client.camera
    return NEAR * 2 * abs(camera.position[2]) * np.tan(camera.fov / 2) / min(camera.image_height or WINDOW, WINDOW)


def _nearest(points: Sequence[Sequence[float]], place: np.ndarray, reach: float) -> int | None:
    """The point next to a place, within reach."""
    if not points or len(points[0]) != 2:
        return None
    gaps = np.linalg.norm(np.array(points) - place, axis=1)
    return int(gaps.argmin()) if gaps.min() <= reach else None


def _between(points: Sequence[Sequence[float]], place: np.ndarray, reach: float) -> int | None:
    """Before which point a place on the line through the points comes; None: it is not on it."""
    for k in range(1, len(points)):
        a, b = np.array(points[k - 1]), np.array(points[k])
        if a.shape != (2,):
            return None
        share = np.clip((place - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0, 1)
        if np.linalg.norm(a + share * (b - a) - place) <= reach:
            return k
    return None
