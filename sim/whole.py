"""Maps of objects whose rough axis was drawn too short: it is carried on while colours beyond its ends are the object's."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .foreground import AXIS, Foreground, colour_cells, foreground, length_of, likelihood
from .sampling import seen_colours

PAST, SURELY = (3.0, 12.0), 0.5
"""From where to where past an end of the map's object it is asked whether it goes on there [lengths of the axis / `AXIS`]:
when of what lies there more than this share has the object's colours."""
BESIDE, LEAK = (2.0, 5.0), 0.15
"""The same all round the object, and the share at which its outline is no outline."""
FURTHER, TIMES = 0.25, 6
"""By how much of its length the axis is carried on at an end that goes on; how often at most."""
WIDER = 1.3
"""How much wider than along the rough axis what goes on may be: a hand is not more of its finger."""


def whole(image: np.ndarray, axis: np.ndarray, found: Foreground, not_here: np.ndarray | None) -> Foreground:
    """A map, or what it becomes on a longer axis if the object goes on past its ends.

    Taken if the object ends there, stands out all round, and is nowhere much wider than along the rough axis; else the map
    stays as it was.

    Args:
        image: as of `foreground`.
        axis: the rough axis, shape (n, 2), image points.
        found: its map.
        not_here: as of `foreground`.

    Returns:
        `found` itself where the axis stays as drawn.
    """
    first = found
    for _ in range(TIMES):
        ends, _ = _goes_on(image, found)
        if not any(ends):
            break
        found = foreground(image, _longer(found.axis, ends), not_here=not_here)
    if found is first:
        return first
    found = foreground(image, _on(found), not_here=not_here)
    ends, beside = _goes_on(image, found)
    return first if any(ends) or beside > LEAK or not _even(found, axis) else found


def _goes_on(image: np.ndarray, map_: Foreground) -> tuple[list[bool], float]:
    """Whether past the first and the last point of the map's axis colours are its object's; their share all round it."""
    shape, mine = map_.inside.shape, map_.inside > 0.5
    x, known = seen_colours(image, None, np.array(map_.origin), map_.step, shape)
    its = likelihood(colour_cells(x), mine, known, x.shape[2]) > 0
    unit = max(1.0, map_.length / AXIS / map_.step)
    away = np.asarray(ndimage.distance_transform_edt(~mine)) / unit
    line, ends = (map_.axis - map_.origin) / map_.step, []
    for end, back in ((0, 10), (-1, -11)):
        way = (line[end] - line[back]) / np.linalg.norm(line[end] - line[back])
        at = np.rint(line[end] + unit * np.arange(*PAST)[:, None] * way).astype(int)
        inside = np.all((at >= 0) & (at < shape[::-1]), axis=1)
        ends.append(bool(its[at[inside, 1], at[inside, 0]].sum() > SURELY * len(at)))
    beside = its[(away > BESIDE[0]) & (away <= BESIDE[1])]
    return ends, float(beside.mean()) if len(beside) else 0.0


def _longer(line: np.ndarray, ends: list[bool]) -> np.ndarray:
    """An axis (n, 2) carried on straight by `FURTHER` of its length at some ends."""
    quarter, reach, tips = len(line) // 4, FURTHER * length_of(line), []
    for goes_on, end, back in zip(ends, (0, -1), (quarter, -1 - quarter), strict=True):
        way = line[end] - line[back]
        tips.append((line[end] + reach * way / np.linalg.norm(way))[None][: int(goes_on)])
    return np.concatenate([tips[0], line, tips[1]])


def _depths(map_: Foreground) -> np.ndarray:
    """Of the points of the map's axis, depth in its object [samples], shape (n,)."""
    depth = np.asarray(ndimage.distance_transform_edt(map_.inside > 0.5))
    at = (map_.axis - map_.origin) / map_.step
    return ndimage.map_coordinates(depth, at.T[::-1], order=1, mode="constant")


def _on(map_: Foreground) -> np.ndarray:
    """The part of the map's axis from where it meets its object to where it leaves it."""
    on = np.flatnonzero(_depths(map_) > 0)
    return map_.axis[on[0] : on[-1] + 1] if len(on) > 10 else map_.axis


def _even(map_: Foreground, axis: np.ndarray) -> bool:
    """Whether the map's object is hardly wider elsewhere than along an axis, shape (n, 2)."""
    depth = _depths(map_)
    first, last = sorted(int(((map_.axis - end) ** 2).sum(axis=1).argmin()) for end in (axis[0], axis[-1]))
    return bool(depth.max() <= WIDER * depth[first : last + 1].max())
