"""Wire frames and contours of many models at once, as segments in a photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symseek.sim.fields import Cut, pieces
from symseek.sim.problem import View
from symseek.sim.surface import smooth_pieces

from .part import Snapshot


@dataclass(frozen=True)
class Detail:
    """How finely a model is drawn."""

    around: int
    """meridians."""
    along: int
    """rings."""
    each: int
    """samples of the surface from one crossing of them to the next."""
    wire: int
    """samples that a segment of the wire frame spans."""
    spine: int
    """nodes that one of the spine spans."""


FINE, COARSE = Detail(12, 8, 5, 1, 1), Detail(8, 5, 2, 2, 3)
"""Of few models, and of many: segments take most of a frame where there is no graphics card."""

Lot = tuple[np.ndarray, np.ndarray]
"""Segments, shape (n, 2, 2), and which model each is of, (n,), in turn."""


def lines_of(snapshots: Sequence[Snapshot], view: View, detail: Detail) -> tuple[Lot, Lot, Lot]:
    """Wire frame on the side that the camera sees, occluding contour i.n = 0 (12), and spine of each model."""
    alike: dict[tuple, list[int]] = {}
    for k, s in enumerate(snapshots):
        alike.setdefault((s.tube.shape, tuple(s.cuts)), []).append(k)
    found: list[tuple[list[Lot], ...]] = []
    for (_, cuts), those in alike.items():
        shut = _closed(np.stack([snapshots[k].tube for k in those]))
        for closed in (True, False):
            own = np.array(those)[shut == closed]
            if len(own):
                found.append(_drawn([snapshots[k] for k in own], own, closed, cuts, view, detail))
    wire, contour, spine = (_joined([lot for lots in kind for lot in lots]) for kind in zip(*found, strict=True))
    return wire, contour, spine


def _closed(tubes: np.ndarray) -> np.ndarray:
    """Whether the end rings of each of them, shape (k, N_x, N_s, 3), are single points; see `surface.is_closed`."""
    sizes = np.linalg.norm(np.ptp(tubes[:, 0], axis=1), axis=1)  # of a meridian: much the same
    return np.ptp(tubes[:, :, [0, -1]], axis=1).max(axis=(1, 2)) < 1e-5 * sizes


def _drawn(
    like: Sequence[Snapshot], own: np.ndarray, closed: bool, cuts: Sequence[Cut], view: View, detail: Detail
) -> tuple[list[Lot], list[Lot], list[Lot]]:
    """The same of models that are alike but in their places; their surfaces are made side by side."""
    ns, ends = like[0].tube.shape[1], pieces(like[0].tube.shape[1], cuts)
    side_by_side = np.concatenate([s.tube for s in like], axis=2)
    grids = smooth_pieces(side_by_side, detail.each * detail.around, detail.each * (detail.along + 1) + 1, cuts)
    nodes = view.camera.project(np.stack([s.spine for s in like]))
    every, wires, contours, spines = np.arange(len(like)), [], [], []
    for piece, (first, last) in zip(grids, ends, strict=True):
        grid = np.moveaxis(piece.reshape(*piece.shape[:2], len(like), 3), 2, 0)
        _, n, m, _ = grid.shape
        ds = np.gradient(grid, axis=2)
        normal = np.cross(np.roll(grid, -1, axis=1) - np.roll(grid, 1, axis=1), ds)
        if closed and first == 0:
            normal[:, :, 0] = -ds[:, :, 1].mean(axis=1, keepdims=True)
        if closed and last == ns - 1:
            normal[:, :, -1] = ds[:, :, -2].mean(axis=1, keepdims=True)
        facing = (view.camera.sight(grid) * normal).sum(axis=3)
        facing, seen = (np.concatenate([v, v[:, :1]], axis=1) for v in (facing, view.camera.project(grid)))
        rings = np.unique(np.linspace(0, m - 1, max(detail.along * (last - first) // (ns - 1), 1) + 2).astype(int))[1:-1]
        lines = np.unique(np.linspace(0, n, detail.around, endpoint=False).astype(int))
        across = np.ix_(every, np.arange(0, n + 1, detail.wire), rings)
        down = np.ix_(every, lines, _steps(m, detail.wire))
        wires += [_near(facing[across], seen[across], 1), _near(facing[down], seen[down], 2)]
        contours.append(_zero(facing, seen))
        points = nodes[:, first : last + 1][:, _steps(last + 1 - first, detail.spine)]
        spines.append(_near(np.zeros(points.shape[:2]), points, 1))
    wires, contours, spines = ([(lot, own[which]) for lot, which in kind] for kind in (wires, contours, spines))
    return wires, contours, spines


def _steps(count: int, step: int) -> np.ndarray:
    """Every `step`-th of so many, and the last."""
    return np.unique([*range(0, count, step), count - 1])


def _joined(lots: Sequence[Lot]) -> Lot:
    """One lot, model by model."""
    segments, which = (np.concatenate(each) for each in zip(*lots, strict=True))
    order = np.argsort(which, kind="stable")
    return segments[order], which[order]


def _near(facing: np.ndarray, seen: np.ndarray, axis: int) -> Lot:
    """Segments along an axis of a grid, `facing` (k, ...) and `seen` (k, ..., 2), of which both ends face the camera."""
    count = seen.shape[axis]
    (fa, fb), (a, b) = ([np.take(v, at, axis) for at in (range(count - 1), range(1, count))] for v in (facing, seen))
    kept = (fa <= 0) & (fb <= 0)
    return np.stack([a, b], axis=-2)[kept], np.nonzero(kept)[0]


def _zero(f: np.ndarray, at: np.ndarray) -> Lot:
    """Where f = 0 on grids, f (k, n, m) at places `at` (k, n, m, 2): a segment through each cell that it crosses."""
    corners = [(v[:, :-1, :-1], v[:, 1:, :-1], v[:, 1:, 1:], v[:, :-1, 1:]) for v in (f, at)]
    values, places = np.stack(corners[0], axis=-1), np.stack(corners[1], axis=-2)
    high = values > 0
    crossed = high.any(axis=-1) & ~high.all(axis=-1)
    which, values, places, high = np.nonzero(crossed)[0], values[crossed], places[crossed], high[crossed]
    after = np.roll(np.arange(4), -1)
    sides = high != high[:, after]
    # on two sides of a cell, or on all four: then there are two segments
    cells, twice = np.arange(len(sides)), np.nonzero(sides.all(axis=1))[0]
    begin, end = sides.argmax(axis=1), 3 - sides[:, ::-1].argmax(axis=1)
    end[twice] = 1
    cells = np.concatenate([cells, twice])
    ends = [np.concatenate([side, np.full(len(twice), other)]) for side, other in ((begin, 2), (end, 3))]
    points = []
    for side in ends:
        u, v = values[cells, side], values[cells, after[side]]
        share = (u / (u - v))[:, None]
        points.append((1 - share) * places[cells, side] + share * places[cells, after[side]])
    return np.stack(points, axis=1), which[cells]
