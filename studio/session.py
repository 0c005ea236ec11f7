"""What a person has made: the tables of a scene file, and every change to them as a step that can be undone.

No page and no solver in it: the page calls the actions, the engine is handed the tubes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from symseek.checks import SceneError, as_annotated
from symseek.scene import Scene, build
from symseek.sim.problem import Settings, Tube, View

Point = Sequence[float] | np.ndarray
"""Image point (column, row)."""
PALETTE = ("#2f9ef4", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#edc948", "#76b7b2", "#ff9da7")
DEPTH_GAP = 0.25
"""Between two objects that the user puts one before the other [shorter sides of the image; depths, if perspective]."""
STEPS_MOST = 1000
"""Steps that can be undone."""
_STAND_IN = [[0.0, 0.0], [12.0, 0.0]]  # fits any image: a scene needs an axis


@dataclass(frozen=True)
class Item:
    """One object."""

    uid: int
    """stays the same while it lives."""
    table: Mapping[str, Any]
    """keys of an [[object]]; never changed in place. An axis of fewer than two points is one still being drawn."""
    colour: str
    """"#rrggbb"."""

    @property
    def name(self) -> str:
        return self.table.get("name", "object")

    @property
    def is_tube(self) -> bool:
        """Snakes and sheets are kept, but neither drawn nor run here."""
        return self.table.get("kind", "tube") == "tube"

    @property
    def depth(self) -> float:
        """In the order of depth; 0 where it is to be found from the image."""
        given = self.table.get("depth", 0.0)
        return 0.0 if given == "auto" else given

    @property
    def points(self) -> list[list[float]]:
        """The rough axis."""
        return list(self.table.get("spine", []))


@dataclass(frozen=True)
class State:
    """All that undo brings back."""

    top: Mapping[str, Any]
    """tables of the scene but its objects."""
    items: tuple[Item, ...] = ()

    def text(self) -> str:
        """As JSON."""
        items = [{"uid": i.uid, "table": i.table, "colour": i.colour} for i in self.items]
        return json.dumps({"top": self.top, "items": items})

    @classmethod
    def of(cls, text: str) -> State:
        """From what `text` wrote.

        Raises:
            ValueError: it is something else.
        """
        try:
            data = json.loads(text)
            return cls(data["top"], tuple(Item(**item) for item in data["items"]))
        except (KeyError, TypeError) as problem:
            raise ValueError(f"not a state of the studio: {problem}") from problem


class Session:
    """The state, its past and its future. Every action either takes place as one step or raises and changes nothing.

    Args:
        state: to begin with.
        base: folder that image paths are relative to.
        source: what messages call the scene.

    Raises:
        SceneError: the scene is at fault, see `symseek.load`.
    """

    def __init__(self, state: State, base: Path, source: str):
        self.state, self.base, self.source = state, base, source
        self._past: list[tuple[State, str]] = []
        self._future: list[tuple[State, str]] = []
        self._merging: object = None
        stand_in = {**state.top, "object": [{"name": "object", "spine": _STAND_IN, "depth": 1.0}]}
        scene = build(stand_in, base, source)
        self.views: list[View] = scene.views
        self.scale, self.name, self._settings = scene.scale, scene.name, scene.settings
        masks = [{} if v.ignore is None else {"ignore": v.ignore.astype(float)} for v in scene.views]
        self._read = [{"image": v.image, **mask} for v, mask in zip(scene.views, masks, strict=True)]
        self._tubes: dict[str, Tube] = {}
        for item in state.items:
            self._check(item)

    # reading

    @property
    def view(self) -> View:
        """The first one, which is drawn on."""
        return self.views[0]

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
                return tube.depth if flat else float((spine @ camera.matrix[2, :3] + camera.matrix[2, 3]).mean())
        return 1.0

    def _views(self, top: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Tables of the views, with their images as they were read."""
        return [{**table, **read} for table, read in zip(top["view"], self._read, strict=True)]

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
        if not item.is_tube or len(item.points) < 2:
            return None
        key = json.dumps(item.table)
        if key not in self._tubes:
            self._tubes = {k: self._tubes[k] for k in list(self._tubes)[-200:]}
            self._tubes[key] = self._built(item).tubes[0]
        return self._tubes[key]

    def settings(self) -> Settings:
        """Of the solver."""
        return replace(self._settings, **self._iterations)

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
        data = {**self.state.top, "object": [dict(item.table) for item in self.state.items]}
        build({**data, "view": self._views(self.state.top)}, self.base, self.source)
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
            pins = [s for s in table.pop("spring") if s.get("stop") is None]
            table |= {"spring": pins} if pins else {}
        changed = replace(item, table=json.loads(json.dumps(table)))
        self._check(changed, top)
        self._do(label, [changed if i.uid == uid else i for i in self.state.items], merging, top)

    def _check(self, item: Item, top: Mapping[str, Any] | None = None) -> None:
        if item.is_tube and len(item.points) < 2:
            item = replace(item, table={**item.table, "spine": _STAND_IN})
        self._built(item, top)

    def _built(self, item: Item, top: Mapping[str, Any] | None = None) -> Scene:
        top = top or self.state.top
        return build(
            {**top, "view": self._views(top), "object": [{"name": item.name, **item.table}]}, self.base, self.source
        )

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
        self._check(renamed)
        self._do("a name", [renamed if i.uid == uid else i for i in self.state.items], ("name", uid))

    def recolour(self, uid: int, colour: str) -> None:
        """Colours an object, "#rrggbb"."""
        old = self.item(uid)
        items = [replace(old, colour=colour) if i.uid == uid else i for i in self.state.items]
        self._do("a colour", items, ("colour", uid))

    def move(self, uid: int, by: int) -> None:
        """Moves an object in the order of depth, `by` places away from the viewer."""
        self.item(uid)
        ranked = sorted((i for i in self.state.items if i.is_tube), key=lambda i: i.depth)
        depths = [i.depth for i in ranked]
        k = next((n for n, i in enumerate(ranked) if i.uid == uid), 0)
        to = min(max(k + by, 0), len(ranked) - 1)
        affine = self.view.camera.affine
        gap = DEPTH_GAP * (min(self.view.image.shape[:2]) * self.scale if affine else max(depths[0], 1e-6))
        for n in range(1, len(depths)):
            depths[n] = max(depths[n], depths[n - 1] + gap)
        ranked.insert(to, ranked.pop(k))
        changed = {
            i.uid: replace(i, table={**i.table, "depth": d})
            for i, d in zip(ranked, depths, strict=True)
            if i.table.get("depth", 0.0) != d
        }
        for item in changed.values():
            self._check(item)
        self._do("the order of depth", [changed.get(i.uid, i) for i in self.state.items])

    def add_point(self, uid: int, point: Point, at: int | None = None) -> None:
        """One more point (column, row) of the rough axis, the last or before point `at`."""
        points = self._flat(uid)
        points.insert(len(points) if at is None else at, _rounded(point))
        self._change(uid, "a point", {"spine": points})

    def move_point(self, uid: int, at: int, point: Point) -> None:
        """Moves point `at`; one drag is one step, see `end_of_drag`."""
        points = self._flat(uid)
        points[_within(at, points, self.source)] = _rounded(point)
        self._change(uid, "moving a point", {"spine": points}, ("point", uid, at))

    def remove_point(self, uid: int, at: int) -> None:
        """Deletes point `at`."""
        points = self._flat(uid)
        del points[_within(at, points, self.source)]
        self._change(uid, "deleting a point", {"spine": points})

    def _flat(self, uid: int) -> list[list[float]]:
        points = self.item(uid).points
        if any(len(p) == 3 for p in points):
            raise SceneError(self.source, "spine", "is given in the world", "edit it in the scene file")
        return points

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

    def break_at(self, uid: int, place: Point, order: str = "tangent") -> None:
        """A crease ("tangent") or a gap ("position") beside an image point."""
        breaks = [*self.item(uid).table.get("break", []), {"at": _rounded(place), "order": order}]
        self._change(uid, "a crease" if order == "tangent" else "a gap", {"break": breaks})

    def mark(self, uid: int, place: Point) -> None:
        """Marks an image point that the object does not cover."""
        self._change(uid, "a mark", {"not_here": [*self.item(uid).table.get("not_here", []), _rounded(place)]})

    def clear(self, uid: int) -> None:
        """Takes away creases, gaps, marks and springs."""
        self._change(uid, "clearing", {"break": None, "not_here": None, "spring": None})

    def record(self, uid: int, springs: Sequence[Mapping[str, Any]]) -> None:
        """Adds what was pulled or pinned, tables [[object.spring]], as one step; after it there is time to rest."""
        most = max([self.settings().iterations, *(at + Settings.iterations for at in _events(springs))])
        top = {**self.state.top, "solver": {**self.state.top.get("solver", {}), "iterations": most}}
        both = [*self.item(uid).table.get("spring", []), *springs]
        if springs:
            self._change(uid, "a pull", {"spring": both}, redrawn=False, top=top)

    def forget_pulls(self) -> None:
        """The runs begin again: nothing was pulled, what is pinned is pinned from the start."""
        items = []
        for item in self.state.items:
            pins = [{**s, "start": 0} for s in item.table.get("spring", []) if s.get("stop") is None]
            table = {k: v for k, v in item.table.items() if k != "spring"} | ({"spring": pins} if pins else {})
            items.append(replace(item, table=table) if item.is_tube else item)
        self._do("the pulls", items)

    def start_over(self, state: State) -> None:
        """Goes to another state of the same image, as one step."""
        if state.top["view"] == self.state.top["view"]:
            self._do("starting over", state.items, top=state.top)


def structure(item: Item) -> str:
    """What a run of the object cannot change on its way: two of the same structure can go on one from the other."""
    table = {k: v for k, v in item.table.items() if k not in ("name", "material", "spring")}
    return json.dumps([table, item.table.get("material", {}).get("closed", True)], sort_keys=True)


def _events(springs: Sequence[Mapping[str, Any]]) -> list[int]:
    return [at for s in springs if isinstance(s, Mapping) for at in (s.get("start"), s.get("stop")) if isinstance(at, int)]


def _rounded(point: Point) -> list[float]:
    return [round(float(v), 2) for v in np.asarray(point, float)]


def _within(at: int, points: list, source: str) -> int:
    if not 0 <= as_annotated(at, int) < len(points):
        raise SceneError(source, "spine", f"has no point {at}", f"it has {len(points)}")
    return at
