"""What a session holds and undo brings back: the tables of a scene file, object by object."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symseek.checks import SceneError, as_annotated

Point = Sequence[float] | np.ndarray
"""Image point (column, row)."""
PALETTE = ("#2f9ef4", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#edc948", "#76b7b2", "#ff9da7")


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
    def in_world(self) -> bool:
        """Whether the rough axis is given in world points."""
        return any(len(p) == 3 for p in self.table.get("spine", []))

    def axes(self, first: str) -> dict[str, list[list[float]]]:
        """Rough axes by view, image points; none of an axis in the world.

        Args:
            first: name of the first view.
        """
        if "spines" in self.table:
            return {name: list(points) for name, points in self.table["spines"].items()}
        return {} if self.in_world else {first: list(self.table.get("spine", []))}

    @property
    def finished(self) -> bool:
        """Whether there are points enough for a tube: two in one view, or in two views each."""
        if "spines" in self.table:
            return sum(len(points) >= 2 for points in self.table["spines"].values()) >= 2
        return len(self.table.get("spine", [])) >= 2

    def for_file(self) -> dict[str, Any]:
        """The table as a scene file takes it: without axes of one point beside whole ones."""
        table = dict(self.table)
        if "spines" in table and self.finished:
            table["spines"] = {name: points for name, points in table["spines"].items() if len(points) >= 2}
        return table

    def structure(self) -> str:
        """What a run of the object cannot change on its way: two of the same structure can go on one from the other."""
        table = {k: v for k, v in self.for_file().items() if k not in ("name", "material", "spring")}
        return json.dumps([table, self.table.get("material", {}).get("closed", True)], sort_keys=True)


def axes_as_keys(axes: Mapping[str, Sequence[Sequence[float]]], first: str) -> dict[str, Any]:
    """Keys of an [[object]] that hold rough axes by view: `spine` where only the first view has one, else `spines`."""
    drawn = {name: list(points) for name, points in axes.items() if points}
    if set(drawn) <= {first}:
        return {"spine": drawn.get(first, []), "spines": None}
    return {"spine": None, "spines": drawn}


@dataclass(frozen=True)
class State:
    """All that undo brings back."""

    top: Mapping[str, Any]
    """tables of the scene but its objects."""
    items: tuple[Item, ...] = ()

    @property
    def pictures(self) -> tuple:
        """What says which images and cameras there are."""
        return tuple(self.top.get(key) for key in ("view", "cameras", "images"))

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


def is_pin(spring: Mapping[str, Any]) -> bool:
    """Whether a spring of the first frame stays for good."""
    return spring.get("stop") is None and not spring.get("frame")


def events_of(springs: Sequence[Mapping[str, Any]]) -> list[int]:
    """Iterations of the first frame at which springs take hold or let go."""
    first = [s for s in springs if isinstance(s, Mapping) and not s.get("frame")]
    return [at for s in first for at in (s.get("start"), s.get("stop")) if isinstance(at, int)]


def rounded(point: Point) -> list[float]:
    """An image point as a file holds it."""
    return [round(float(v), 2) for v in np.asarray(point, float)]


def within(at: int, points: list, source: str) -> int:
    """Number `at`, if there is such a point."""
    if not 0 <= as_annotated(at, int) < len(points):
        raise SceneError(source, "spine", f"has no point {at}", f"it has {len(points)}")
    return at
