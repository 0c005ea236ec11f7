"""Foreground maps of several objects in one image, each made with the others in mind."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from .beyond import unseen
from .foreground import Foreground, axis_curve, carried_on, foreground
from .hidden import window
from .problem import View
from .whole import whole

OFF = 1.2
"""Another object's axis is surely not this one beyond so many half widths from its own."""
CLEAR = 0.5
"""How far from what is hidden the map's axis is the object's middle, in half widths."""
LEAST = 0.3
"""Least half width of what is hidden beside where it was seen last."""
CLOSE = 0.2
"""How near to what lies behind an outline is taken to lie over it, in half widths."""
RIM = 1.0
"""How far beyond the outline of what lies in front colours are not looked at [image px]."""


def foregrounds(
    view: View,
    axes: Sequence[np.ndarray],
    marks: Sequence[np.ndarray | None],
    depths: Sequence[float],
    goes_on: Sequence[tuple[bool, bool]] | None = None,
) -> list[Foreground]:
    """The foreground map of each object.

    Made once for each object alone. Where others are near, once more: their axes are background, apart from what runs
    along its own; and what lies in front, from the nearest on, is not looked at, so that a map goes on below it as its
    seeds and the smoothness of its outline say. What lies behind is told by the maps made for each alone.

    Args:
        view: image and what is not to be looked at.
        axes: rough axis of each object, shape (n, 2), image points.
        marks: image points (k, 2) of each that are not it, or None.
        depths: of each, larger is further away; of two as deep, neither is in front.
        goes_on: of each, see `Tube.goes_on`.
    """
    curves, size = [axis_curve(axis) for axis in axes], view.image.shape[:2]
    masks = [unseen(view.ignore, c, e, size) for c, e in zip(curves, goes_on or [(False, False)] * len(axes), strict=True)]
    maps = [foreground(view.image, *own) for own in zip(axes, masks, marks, strict=True)]
    maps = [m if mask is None else completed(m, c, mask) for m, c, mask in zip(maps, curves, masks, strict=True)]
    boxes = np.array([m.box for m in maps])
    covers: dict[int, tuple[tuple[slice, slice], np.ndarray, np.ndarray]] = {}  # of what lies in front, by the nearest first
    # pictures are large and objects many: only where there is something they are written and cleared again
    none = np.zeros(size, bool)
    hides, ignore = none.copy(), none.copy()
    for k in sorted(range(len(axes)), key=lambda k: depths[k]):
        near = np.all((boxes[:, 0] < boxes[k, 1]) & (boxes[k, 0] < boxes[:, 1]), axis=1)
        near[k] = False
        beside: list[int] = np.flatnonzero(near).tolist()
        if not beside:
            if masks[k] is None:
                maps[k] = whole(view.image, axes[k], maps[k], marks[k])
            continue
        ahead = [j for j in beside if depths[j] < depths[k]]
        for j in ahead:
            if j not in covers:
                covers[j] = _cover(maps[j], size)
            part, mask, wide = covers[j]
            hides[part] |= mask
            ignore[part] |= wide
        mask = masks[k]
        masked = bool(ahead) or mask is not None
        others = [_apart(curves[j], curves[k], OFF * maps[k].half_width) for j in beside if j not in ahead]
        wide = ignore if mask is None else ignore | mask
        maps[k] = foreground(view.image, axes[k], wide if masked else None, marks[k], others)
        if masked:
            maps[k] = completed(maps[k], curves[k], hides if mask is None else hides | mask)
        if behind := [j for j in beside if depths[j] > depths[k]]:
            maps[k] = _before(maps[k], [maps[j] for j in behind])
        for j in ahead:
            part = covers[j][0]
            hides[part] = ignore[part] = none[part]
    return maps


def _before(map_: Foreground, others: Sequence[Foreground]) -> Foreground:
    """A map with `Foreground.behind`, from maps of the others, which lie behind."""
    seen = np.max([other.in_image(map_.inside.shape, map_.origin, map_.step) for other in others], axis=0)
    behind = ndimage.grey_dilation(seen, 2 * round(CLOSE * map_.half_width / map_.step) + 1)
    return dataclasses.replace(map_, behind=behind.astype(np.float32))


def _cover(map_: Foreground, size: tuple[int, ...]) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """Where a map's object covers an image of a size (height, width): the part, the cover, one `RIM` wider."""
    part = rows, columns = window(map_.box, size, RIM)
    cover = map_.in_image((rows.stop - rows.start, columns.stop - columns.start), (columns.start, rows.start)) > 0.5
    return part, cover, ndimage.binary_dilation(cover, iterations=round(RIM)) if cover.any() else cover


def completed(map_: Foreground, given: np.ndarray, hides: np.ndarray) -> Foreground:
    """A map in which what is hidden goes on as a round object would: as wide to either side of its axis.

    Hidden samples are the object's where they lie in a ball about the axis that reaches the outline where it is seen. Where
    the axis itself is hidden, it runs as it was drawn, moved as its seen parts have been moved to the object's middle, and
    the balls go on as they were seen last; a hidden end is a ball about the last point drawn.

    Args:
        map_: made without a look at what is hidden.
        given: the rough axis, shape (n, 2), image points.
        hides: shape (H, W), where another object covers the image.
    """
    h, w = map_.inside.shape
    points = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1) * map_.step + map_.origin
    hidden = _covered(hides, points)
    seen = ~_covered(hides, given)
    if not hidden.any() or seen.sum() < 2:
        return map_

    def at(values: np.ndarray, places: np.ndarray) -> np.ndarray:
        where = ((places - map_.origin) / map_.step).T[::-1]
        return ndimage.map_coordinates(values, where, order=1, mode="nearest") * map_.step

    ground = (map_.inside < 0.5) & ~hidden
    off = np.asarray(ndimage.distance_transform_edt(~ground))
    clear = at(np.asarray(ndimage.distance_transform_edt(~hidden)), given) > CLEAR * map_.half_width
    where = np.flatnonzero(clear if clear.any() else seen)
    moved = map_.axis[np.linalg.norm(given[where][:, None] - map_.axis[None], axis=2).argmin(axis=1)] - given[where]
    steps = np.arange(len(given))
    line = given + np.stack([np.interp(steps, where, moved[:, i]) for i in range(2)], axis=1)
    wide = _carried_width(at(off, line), seen, line)
    wide = np.minimum(wide, at(off, line))  # what is seen as background is not the object's
    gap = np.linalg.norm(points[hidden][:, None] - line[None], axis=2)
    inside = map_.inside.copy()
    inside[hidden] = 1 / (1 + np.exp(-np.clip(2 * (wide - gap).max(axis=1) / map_.step, -30, 30)))
    tangent = np.gradient(line, axis=0)
    across = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / (np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12)
    sides = np.logical_and(*(_covered(hides, line + way * wide[:, None] * across) for way in (-1, 1)))
    for end in (0, -1):  # a hidden end, whose cap has no word but the map's
        sides |= ~seen[end] & (np.linalg.norm(line - line[end], axis=1) < wide[end])
    guess = np.zeros(inside.shape, np.float32)
    guess[hidden] = sides[gap.argmin(axis=1)]
    ahead = np.concatenate([[True], np.any(np.diff(line, axis=0) != 0, axis=1)]) & (wide > 0)
    line = axis_curve(line[ahead]) if ahead.sum() > 3 else given
    half_width = max(float(np.median(wide)), 2 * map_.step)
    flat, length, half = (line - map_.origin) / map_.step, map_.length / map_.step, half_width / map_.step
    axis = carried_on(inside > 0.5, flat, length, half) * map_.step + map_.origin
    return dataclasses.replace(map_, inside=inside, guess=guess, half_width=half_width, axis=axis)


def _carried_width(wide: np.ndarray, seen: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Half widths (n,) along a line where seen; between that even, beyond it as they last went, by less and less."""
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    where = np.flatnonzero(seen)
    out = np.interp(arc, arc[where], wide[where])
    for last, beyond in ((where[0], slice(None, where[0])), (where[-1], slice(where[-1] + 1, None))):
        near = where[np.abs(arc[where] - arc[last]) < wide[last]]
        if len(near) > 2 and np.ptp(arc[near]) > 0 and wide[last] > 0:
            slope = np.polyfit(np.abs(arc[near] - arc[last]), wide[near], 1)[0]
            way = np.abs(arc[beyond] - arc[last]) / wide[last]
            out[beyond] = wide[last] * np.maximum(1 - slope * (1 - np.exp(-way)), LEAST)
    return out


def _covered(hides: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether image points (..., 2) are covered."""
    column, row = np.moveaxis(np.rint(points).astype(int), -1, 0)
    return hides[np.clip(row, 0, hides.shape[0] - 1), np.clip(column, 0, hides.shape[1] - 1)]


def _apart(curve: np.ndarray, own: np.ndarray, distance: float) -> np.ndarray:
    """Points of a curve (n, 2) further than a distance from another (m, 2)."""
    gap = np.linalg.norm(curve[:, None] - own[None], axis=2).min(axis=1)
    return curve[gap > distance]
