"""What a person has marked on an object: where it is not, where it has creases and gaps."""

from __future__ import annotations

import numpy as np

from .part import Snapshot
from .session import PAINTED, Session
from .state import Item

NOT_HERE, CREASE, GAP = (235, 64, 52), (255, 255, 255), (20, 20, 20)
"""Colours."""


def marks_of(session: Session, item: Item, s: Snapshot | None, v: int) -> list[tuple[np.ndarray, tuple[int, int, int]]]:
    """Image points (n, 2) of view v, each lot with its colour; those of the first view alone, but for what was painted."""
    breaks = [b for b in item.table.get("break", []) if len(np.atleast_1d(b.get("at", 0.0))) == 2]
    lots = [
        (item.table.get("not_here", []), NOT_HERE),
        ([b["at"] for b in breaks if b.get("order") != "position"], CREASE),
        ([b["at"] for b in breaks if b.get("order") == "position"], GAP),
    ]
    found = [(np.array(session.scenery.seen(0, points), float), colour) for points, colour in lots if points and v == 0]
    painted = np.array(item.table.get("material", {}).get(PAINTED, 1.0))
    if s is not None and painted.shape == s.tube.shape[:2]:
        found.append((session.views[v].camera.project(s.tube[painted == 0]), CREASE))
    return [(points, colour) for points, colour in found if len(points)]
