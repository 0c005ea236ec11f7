"""What a person has made: the tables of a scene file, and every change to them as a step that can be undone.

No page and no solver in it: the page calls the actions, the engine is handed the tubes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from symseek.checks import SceneError, as_annotated
from symseek.scene import Scene
from symseek.sim.fields import as_field
from symseek.sim.foreground import axis_curve
from symseek.sim.initial import lift
from symseek.sim.material import Material
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.sights import meeting
from symseek.sim.spring import Spring

from .scenery import Scenery
from .state import PALETTE, Item, Point, State, axes_as_keys, events_of, is_pin, rounded, within

DEPTH_GAP = 0.25
"""Between two objects that the user puts one before the other [shorter sides of the image; depths, if perspective]."""
STEPS_MOST = 1000
"""Steps that can be undone."""
PAINTED = "w02"
"""Rigidity that is 0 where a crease is painted: without that around, w20, nodes would have nothing to hold them round."""


class Session:
    """The state, its past and its future. Every action either takes place as one step or raises and changes nothing.

    Args:
        state: to begin with.
        base: folder that image paths are relative to.
        source: what messages call the scene.
        scene: the same with its images read, if it is there already.

    Raises:
        SceneError: the scene is at fault, see `symseek.load`.
    """

    def __init__(self, state: State, base: Path, source: str, scene: Scene | None = None):
        self.state, self.base, self.source = state, base, source
        self._past: list[tuple[State, str]] = []
        self._future: list[tuple[State, str]] = []
        self._merging: object = None
        self.scenery = Scenery(state.top, base, source, scene)
        self.views, self.frames, self.name = self.scenery.views, self.scenery.frames, self.scenery.name
        for item in state.items:
            self.scenery.check(item, state.top)

    # reading

    @property
    def view(self) -> View:
        """The first one."""
        return self.views[0]

    @property
    def moving(self) -> bool:
        """Whether the scene has frames."""
        return bool(self.frames)

    @property
    def depth(self) -> float:
        """Of what is drawn next: where the first object is, if the view is a perspective one."""
        camera = self.view.camera
        if camera.affine:
            return 0.0
        for tube in (self.tube(item) for item in self.state.items):
            if tube is not None:
                spine = np.asarray(tube.spine)
                flat = spine.shape[1] == 2
                return tube.depth if flat else float(camera.depth(spine).mean())
        return 1.0

    def depths(self) -> list[float]:
        """For each view how deep what is looked at lies, as `initial.lift` counts it: where the first object is."""
        if len(self.views) == 1:
            return [self.depth]
        cameras = [view.camera for view in self.views]
        tube = next((t for t in map(self.tube, self.state.items) if t is not None), None)
        if tube is None:
            sizes = [np.array(view.image.shape[1::-1]) for view in self.views]
            at = meeting([(size[None] - 1) / 2 for size in sizes], cameras)[0]
        else:
            spine = np.asarray(tube.spine, float)
            at = (spine if spine.shape[1] == 3 else lift(spine, cameras[0], tube.depth)).mean(axis=0)
        return [float(camera.depth(at)) for camera in cameras]

    def item(self, uid: int) -> Item:
        """Object `uid`.

        Raises:
            SceneError: there is none any more.
        """
        for item in self.state.items:
            if item.uid == uid:
                return item
        raise SceneError(self.source, "", "this object is no longer there", "choose another")

    def tube(self, item: Item) -> Tube | None:
        """The object as the solver takes it; None while its axis is still being drawn, and for snakes and sheets."""
        return self.scenery.tube(item, self.state.top)

    def settings(self) -> Settings:
        """Of the solver."""
        return replace(self.scenery.settings, **self._iterations)

    @property
    def _iterations(self) -> dict[str, int]:
        """What `record` has changed of the settings."""
        given = self.state.top.get("solver", {})
        return {"iterations": given["iterations"]} if "iterations" in given else {}

    def tables(self) -> dict[str, Any]:
        """The tables of the scene as its file holds them.

        Raises:
            SceneError: there is no object, or the axis of one is not finished.
        """
        if not self.state.items:
            raise SceneError(self.source, "object", "there is none yet", "click points along the axis of one")
        data = {**self.state.top, "object": [item.for_file() for item in self.state.items]}
        self.scenery.build(data)
        return data

    @property
    def can_undo(self) -> str:
        """What would be undone; "" if nothing."""
        return self._past[-1][1] if self._past else ""

    @property
    def can_redo(self) -> str:
        """What would be done again; "" if nothing."""
        return self._future[-1][1] if self._future else ""

    # steps

    def undo(self) -> bool:
        """Takes the last step back; False if there is none."""
        return self._go(self._past, self._future)

    def redo(self) -> bool:
        """Takes the step again that was undone last; False if there is none."""
        return self._go(self._future, self._past)

    def _go(self, there: list[tuple[State, str]], back: list[tuple[State, str]]) -> bool:
        if not there:
            return False
        state, label = there.pop()
        back.append((self.state, label))
        self.state, self._merging = state, None
        return True

    def _do(self, label: str, items: Sequence[Item], merging: object = None, top: Mapping[str, Any] | None = None) -> None:
        """One step, or more of the last one where both merge by the same key."""
        state = State(top or self.state.top, tuple(items))
        if state == self.state:
            return
        if merging is None or merging != self._merging:
            self._past = [*self._past, (self.state, label)][-STEPS_MOST:]
        self.state, self._future, self._merging = state, [], merging

    def end_of_drag(self) -> None:
        """What comes next is a step of its own."""
        self._merging = None

    def _change(
        self, uid: int, label: str, values: Mapping[str, Any], merging: object = None, redrawn: bool = True,
        top: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Changes keys of an object's table, None to leave one out; what was pulled on the way is another run's."""
        item = self.item(uid)
        if not item.is_tube:
            kind = item.table["kind"]
            raise SceneError(self.source, item.name, f"is a {kind}", "it is kept in the file; edit it there")
        table = {k: v for k, v in {**item.table, **values}.items() if v is not None}
        if redrawn and "spring" in table:
            pins = [s for s in table.pop("spring") if is_pin(s)]
            table |= {"spring": pins} if pins else {}
        changed = replace(item, table=json.loads(json.dumps(table)))
        self.scenery.check(changed, top or self.state.top)
        self._do(label, [changed if i.uid == uid else i for i in self.state.items], merging, top)

    # actions

    def add(self) -> int:
        """A new object, to be drawn; returns its uid."""
        taken = {i.name for i in self.state.items}
        name = next(n for n in (f"object {k}" for k in range(1, len(taken) + 2)) if n not in taken)
        uid = 1 + max((i.uid for i in self._ever()), default=0)
        table = {"name": name} | ({} if self.view.camera.affine else {"depth": self.depth})
        self._do("a new object", [*self.state.items, Item(uid, table, PALETTE[(uid - 1) % len(PALETTE)])])
        return uid

    def _ever(self) -> list[Item]:
        """Objects of every state that can come back, so that no two of them share a uid."""
        return [i for state in (self.state, *(s for s, _ in (*self._past, *self._future))) for i in state.items]

    def remove(self, uid: int) -> None:
        """Deletes an object."""
        gone = self.item(uid)
        self._do(f"deleting {gone.name}", [i for i in self.state.items if i.uid != uid])

    def rename(self, uid: int, name: str) -> None:
        """Names an object, and with it its files.

        Raises:
            SceneError: the name cannot be a file's, or is another object's.
        """
        if any(i.name == name and i.uid != uid for i in self.state.items):
            raise SceneError(self.source, "name", f"{name!r} is another object's", "give it a name of its own")
        renamed = replace(self.item(uid), table={**self.item(uid).table, "name": name})
        self.scenery.check(renamed, self.state.top)
        self._do("a name", [renamed if i.uid == uid else i for i in self.state.items], ("name", uid))

    def recolour(self, uid: int, colour: str) -> None:
        """Colours an object, "#rrggbb"."""
        old = self.item(uid)
        items = [replace(old, colour=colour) if i.uid == uid else i for i in self.state.items]
        self._do("a colour", items, ("colour", uid))

    def _ranked(self, uid: int) -> tuple[list[Item], int]:
        """Objects in the order of depth, the nearest first, and which one it is."""
        self.item(uid)
        ranked = sorted((i for i in self.state.items if i.is_tube), key=lambda i: i.depth)
        return ranked, next((n for n, i in enumerate(ranked) if i.uid == uid), 0)

    def place(self, uid: int) -> tuple[int, int]:
        """Which one it is in the order of depth, 1 the nearest, and of how many."""
        ranked, k = self._ranked(uid)
        return k + 1, len(ranked)

    def move(self, uid: int, by: int) -> None:
        """Moves an object in the order of depth, `by` places away from the viewer; one drag is one step."""
        if len(self.views) > 1:
            raise SceneError(self.source, "depth", "several views tell it", "draw the axis in two of them")
        ranked, k = self._ranked(uid)
        depths = [i.depth for i in ranked]
        to = min(max(k + by, 0), len(ranked) - 1)
        affine = self.view.camera.affine
        gap = DEPTH_GAP * (min(self.view.image.shape[:2]) * self.scenery.scale if affine else max(depths[0], 1e-6))
        for n in range(1, len(depths)):
            depths[n] = max(depths[n], depths[n - 1] + gap)
        ranked.insert(to, ranked.pop(k))
        changed = {
            i.uid: replace(i, table={**i.table, "depth": d})
            for i, d in zip(ranked, depths, strict=True)
            if i.table.get("depth", 0.0) != d
        }
        for item in changed.values():
            self.scenery.check(item, self.state.top)
        self._do("the order of depth", [changed.get(i.uid, i) for i in self.state.items], ("depth", uid))

    def add_point(self, uid: int, point: Point, at: int | None = None, view: int = 0) -> None:
        """One more point (column, row) of the rough axis in a view, the last or before point `at`."""
        points = self._given(uid, view)
        points.insert(len(points) if at is None else at, rounded(self.scenery.given(view, point)))
        self._redraw(uid, view, points, "a point")

    def move_point(self, uid: int, at: int, point: Point, view: int = 0) -> None:
        """Moves point `at`; one drag is one step, see `end_of_drag`."""
        points = self._given(uid, view)
        points[within(at, points, self.source)] = rounded(self.scenery.given(view, point))
        self._redraw(uid, view, points, "moving a point", ("point", uid, at, view))

    def remove_point(self, uid: int, at: int, view: int = 0) -> None:
        """Deletes point `at`."""
        points = self._given(uid, view)
        del points[within(at, points, self.source)]
        self._redraw(uid, view, points, "deleting a point")

    def axis(self, uid: int, view: int = 0) -> list[list[float]]:
        """Points of the rough axis in a view, as it is shown.

        Raises:
            SceneError: it is given in the world.
        """
        return self.scenery.seen(view, self._given(uid, view))

    def _given(self, uid: int, view: int) -> list[list[float]]:
        item = self.item(uid)
        if item.in_world:
            raise SceneError(self.source, "spine", "is given in the world", "edit it in the scene file")
        if view not in range(len(self.views)):
            raise SceneError(self.source, "view", f"there is no view {view}", f"the scene has {len(self.views)}")
        return item.axes(self.view.name).get(self.views[view].name, [])

    def _redraw(self, uid: int, view: int, points: list[list[float]], label: str, merging: object = None) -> None:
        axes = {**self.item(uid).axes(self.view.name), self.views[view].name: points}
        self._change(uid, label, axes_as_keys(axes, self.view.name), merging)

    def set_radius(self, uid: int, radius: float | None) -> None:
        """Radius of the first tube [world units]; None: from the image."""
        self._change(uid, "the radius", {"radius": radius}, ("radius", uid))

    def set_weight(self, uid: int, values: Mapping[str, Any]) -> None:
        """Weights of the material by name, None for the default; of one drag of a slider the last ones count."""
        material = {**self.item(uid).table.get("material", {}), **values}
        material = {k: v for k, v in material.items() if v is not None}
        names = tuple(values)
        label = f"material {', '.join(names)}"
        self._change(uid, label, {"material": material or None}, ("weight", uid, names), redrawn="closed" in names)

    def break_at(self, uid: int, place: Point, order: str = "tangent", view: int = 0) -> None:
        """A crease ("tangent") or a gap ("position") beside an image point."""
        breaks = [*self.item(uid).table.get("break", []), {"at": rounded(self._in_first(uid, place, view)), "order": order}]
        self._change(uid, "a crease" if order == "tangent" else "a gap", {"break": breaks})

    def _in_first(self, uid: int, place: Point, view: int) -> Point:
        """An image point of any view as the file has one of the first, by the place of the rough axis next to it."""
        tube = self.tube(self.item(uid)) if view else None
        if tube is None:
            return self.scenery.given(0, place)
        spine = np.asarray(tube.spine, float)
        axis = axis_curve(spine if spine.shape[1] == 3 else lift(spine, self.view.camera, tube.depth))
        gap = np.linalg.norm(self.views[view].camera.project(axis) - np.asarray(place), axis=1)
        return self.scenery.given(0, self.view.camera.project(axis[gap.argmin()]))

    def paint(self, uid: int, nodes: Sequence[tuple[int, int]]) -> None:
        """Takes the rigidity along s away at nodes (around, along): the surface may have an edge; one stroke is one step."""
        item = self.item(uid)
        material, (nx, ns) = dict(item.table.get("material", {})), item.table.get("grid", (25, 25))
        for i, j in nodes:
            if not (0 <= as_annotated(i, int) < nx and 0 <= as_annotated(j, int) < ns):
                raise SceneError(self.source, "material", f"there is no node {i}, {j}", f"the grid has {nx} x {ns}")
        for name in [PAINTED] + ["w11"] * ("w11" in material):  # which may not be more than the others allow
            values = as_field(name, material.get(name, getattr(Material(), name)), (nx, ns)).T
            for i, j in nodes:
                values[i, j] = 0.0
            material[name] = [[float(f"{v:.6g}") for v in row] for row in values]
        self._change(uid, "a painted crease", {"material": material}, ("paint", uid), redrawn=False)

    def mark(self, uid: int, place: Point, view: int = 0) -> None:
        """Marks an image point that the object does not cover."""
        if view:
            raise SceneError(self.source, "not_here", "marks are of the first view", f"look through {self.view.name!r}")
        marks = [*self.item(uid).table.get("not_here", []), rounded(self.scenery.given(0, place))]
        self._change(uid, "a mark", {"not_here": marks})

    def clear(self, uid: int) -> None:
        """Takes away creases, gaps, marks and springs."""
        self._change(uid, "clearing", {"break": None, "not_here": None, "spring": None})

    def written(self, springs: Sequence[Spring]) -> list[dict[str, Any]]:
        """Springs as tables [[object.spring]]."""
        tables = []
        for s in springs:
            anchor = self.scenery.given(s.view, s.anchor) if len(s.anchor) == 2 else list(s.anchor)
            table = {"anchor": anchor, "stiffness": s.stiffness, "start": s.start}
            table |= {"view": self.views[s.view].name} if s.view and len(s.anchor) == 2 else {}
            table |= {"frame": s.frame} if s.frame else {}
            table |= {"point": list(s.point)} if s.point is not None else {"reach": s.reach}
            tables.append(table | ({"stop": s.stop} if s.stop is not None else {}))
        return tables

    def record(self, uid: int, springs: Sequence[Mapping[str, Any]]) -> None:
        """Adds what was pulled or pinned, tables [[object.spring]], as one step; after it there is time to rest."""
        top, events = self.state.top, events_of(springs)
        if events:
            most = max(self.settings().iterations, max(events) + Settings.iterations)
            top = {**top, "solver": {**top.get("solver", {}), "iterations": most}}
        both = [*self.item(uid).table.get("spring", []), *springs]
        if springs:
            self._change(uid, "a pull", {"spring": both}, redrawn=False, top=top)

    def forget_pulls(self) -> None:
        """The runs begin again: nothing was pulled, what is pinned is pinned from the start."""
        items = []
        for item in self.state.items:
            pins = [{**s, "start": 0} for s in item.table.get("spring", []) if is_pin(s)]
            table = {k: v for k, v in item.table.items() if k != "spring"} | ({"spring": pins} if pins else {})
            items.append(replace(item, table=table) if item.is_tube else item)
        self._do("the pulls", items)

    def start_over(self, state: State) -> None:
        """Goes to another state of the same image, as one step."""
        if state.pictures == self.state.pictures:
            self._do("starting over", state.items, top=state.top)
