"""What was read of a scene once, its images and cameras, and the check of each object against them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from symseek.checks import SceneError
from symseek.objects import SPINE_MIN, STEP_MIN
from symseek.scene import Scene, build
from symseek.sim.problem import Tube, View

from .state import Item, Point

KNOWN = 200
"""Objects that are remembered as built."""


class Scenery:
    """Views with their images, and objects built in them.

    Args:
        top: tables of the scene but its objects.
        base: folder that image paths are relative to.
        source: what messages call the scene.
        scene: the same with its images read, if it is there already.

    Raises:
        SceneError: the scene is at fault, see `symseek.load`.
    """

    def __init__(self, top: Mapping[str, Any], base: Path, source: str, scene: Scene | None = None):
        self.base, self.source = base, source
        if scene is None:
            scene = build({**top, "object": [{"name": "object", **_stand_in(top, base, source)}]}, base, source)
        self.views: list[View] = scene.views
        self.frames, self.tracking = scene.frames, scene.tracking
        self.scale, self.name, self.settings = scene.scale, scene.name, scene.settings
        self._scene = scene
        self._tubes: dict[str, Tube | None] = {}

    def build(self, data: Mapping[str, Any], views: slice = slice(None)) -> Scene:
        """A scene from its tables, with images as they were read.

        Raises:
            SceneError: it is at fault.
        """
        known = replace(self._scene, views=self.views[views], frames=self.frames[views])
        return build(data, self.base, self.source, known=known)

    def given(self, v: int, point: Point) -> list[float]:
        """An image point of view v as the scene's file has it, which counts in the image as the lens bent it."""
        lens = self.views[v].lens
        return [float(x) for x in (point if lens is None else lens.bent(np.array([point], float))[0])]

    def seen(self, v: int, points: Sequence[Sequence[float]]) -> list[list[float]]:
        """Image points of a file as view v shows them."""
        lens = self.views[v].lens
        return [list(p) for p in points] if lens is None or not points else lens.straight(np.array(points)).tolist()

    def tube(self, item: Item, top: Mapping[str, Any]) -> Tube | None:
        """An object as the solver takes it; None while its axis is still being drawn, and for snakes and sheets."""
        if not item.is_tube or not item.finished:
            return None
        key = json.dumps(item.table)
        if key not in self._tubes:
            self._tubes = {k: self._tubes[k] for k in list(self._tubes)[-KNOWN:]}
            try:
                self._tubes[key] = self._with(item, top).tubes[0]
            except SceneError:
                if not self._waits(item):
                    raise
                self._tubes[key] = None
        return self._tubes[key]

    def check(self, item: Item, top: Mapping[str, Any]) -> None:
        """Refuses what no scene file may hold; of an axis that is not whole, or waits for another view's, all but that.

        Raises:
            SceneError: the object is at fault.
        """
        try:
            if not item.is_tube or item.finished:
                self._with(item, top)
                return
        except SceneError:
            if not self._waits(item):
                raise
        axes = item.axes(self.views[0].name) or {self.views[0].name: []}
        for name, points in axes.items():
            v = self.number(name)
            size = self.views[v].image.shape[:2]
            for x, y in points:
                if not (-0.5 <= x <= size[1] - 0.5 and -0.5 <= y <= size[0] - 0.5):
                    what = f"[{x:g}, {y:g}] lies outside the image of {size[1]} x {size[0]} pixels"
                    raise SceneError(self.source, "spine", what, "click on the image")
            alone = {k: w for k, w in item.table.items() if v == 0 and k not in ("spine", "spines", "depth")}
            if len(self.views) > 1:  # its springs may be of views that are not there
                alone.pop("spring", None)
            axis = points if len(points) >= 2 and not self._short(item) else _across(size)
            table = {**alone, "name": item.name, "spine": axis, "depth": 1.0}
            self._with(replace(item, table=table), top, slice(v, v + 1))

    def _waits(self, item: Item) -> bool:
        """Whether an axis waits for more points, or for one in another view, its depth being a guess."""
        return self._short(item) or (len(self.views) > 1 and "spines" not in item.table and not item.in_world)

    def _short(self, item: Item) -> bool:
        """Whether an axis in the first view is too short as yet; its points lie apart."""
        points = np.array([] if item.in_world else item.table.get("spine", []), float).reshape(-1, 2)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        return len(points) > 1 and steps.sum() < SPINE_MIN and steps.min() >= STEP_MIN

    def _with(self, item: Item, top: Mapping[str, Any], views: slice = slice(None)) -> Scene:
        return self.build({**top, "object": [{"name": item.name, **item.for_file()}]}, views)

    def number(self, name: str) -> int:
        """Of the view of that name.

        Raises:
            SceneError: there is none.
        """
        names = [view.name for view in self.views]
        if name not in names:
            raise SceneError(self.source, "spines", f"{name!r} is no view", f"the views are {', '.join(names)}")
        return names.index(name)


def _across(size: tuple[int, ...]) -> list[list[float]]:
    """An axis in the middle of any image: a scene needs one."""
    height, width = size[:2]
    reach = max(6.0, 0.1 * width)
    return [[0.5 * width - reach, 0.5 * height], [0.5 * width + reach, 0.5 * height]]


def _stand_in(top: Mapping[str, Any], base: Path, source: str) -> dict[str, Any]:
    """Keys of an object that one view sees, or both of a stereo pair."""
    plain = {k: top[k] for k in ("units", "scale") if k in top}
    first = {"view": [top["view"][0]], "object": [{"spine": [[0, 0], [12, 0]], "depth": 1.0}], **plain}
    view = build(first, base, source).views[0]
    return {"spine": _across(view.image.shape), "depth": 0.0 if view.camera.affine else 1.0}
