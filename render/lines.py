"""Anti-aliased lines of any width at sub-pixel positions: coverage follows from the distance to the line.

Points are (column, row) of the image drawn into, pixel centres at whole numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Polylines = Sequence[np.ndarray]
Colour = tuple[int, int, int]

_PIECE = 3.0  # px; long lines are cut so that a small square of pixels serves each piece
_CHUNK = 400_000  # pixels looked at in one go, which bounds the memory
_MOST_DASHES = 5000


class Pen(NamedTuple):
    """How a line looks."""

    colour: Colour
    """RGB, 0 to 255."""
    width: float
    """px; below one the line fades instead."""
    alpha: float = 1.0
    """opacity, 0 to 1."""


def stroke(image: np.ndarray, lines: Polylines, *pens: Pen) -> None:
    """Draw polylines with round caps and joins, in place; where they cross, nothing is drawn twice.

    Args:
        image: shape (H, W, 3), uint8, C-contiguous.
        lines: each of shape (n, 2), n >= 1, px; parts with points that are not finite are left out.
        pens: each draws all the lines, the first one lowest.

    Raises:
        ValueError: the image is not writable in place.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or not image.flags.c_contiguous:
        raise ValueError(f"image must be C-contiguous uint8 (H, W, 3), not {image.dtype} {image.shape}")
    away = distance(lines, max(_half(pen.width) for pen in pens), image.shape[:2]).ravel()
    where = np.flatnonzero(away < np.inf)
    away, pixels = away[where, None], image.reshape(-1, 3)
    blend = pixels[where].astype(np.float32)
    for pen in pens:
        blend += pen.alpha * _cover(away, pen.width) * (np.asarray(pen.colour, np.float32) - blend)
    pixels[where] = np.rint(blend)


def coverage(lines: Polylines, width: float, shape: tuple[int, int]) -> np.ndarray:
    """Share of each pixel that lines of a width in px cover, shape (H, W), float32 in [0, 1]."""
    return _cover(distance(lines, _half(width), shape), width)


def distance(lines: Polylines, within: float, shape: tuple[int, int]) -> np.ndarray:
    """Distance of each pixel to the nearest line, shape (H, W), float32, px; infinite from `within` on."""
    height, breadth = shape
    nearest = np.full(height * breadth, np.inf, np.float32)
    reach = int(np.ceil(_PIECE / 2 + within + 0.5))  # the half: the square is centred on a pixel
    starts, ends = _pieces(lines, np.array([breadth, height], float), reach)
    side = 2 * reach + 1
    for first in range(0, len(starts), _CHUNK // side**2 + 1):
        chunk = slice(first, first + _CHUNK // side**2 + 1)
        middle = np.rint((starts[chunk] + ends[chunk]) / 2)
        away = _distances(starts[chunk] - middle, ends[chunk] - middle, reach).ravel()
        near = np.flatnonzero(away < within)
        piece, row, column = np.unravel_index(near, (len(middle), side, side))
        column = column + middle[piece, 0].astype(np.int64) - reach
        row = row + middle[piece, 1].astype(np.int64) - reach
        inside = (column >= 0) & (column < breadth) & (row >= 0) & (row < height)
        np.minimum.at(nearest, (row * breadth + column)[inside], away[near[inside]])
    return nearest.reshape(shape)


def _half(width: float) -> float:
    """Distance at which a line's cover ends: half its width and half a pixel."""
    return max(width, 1.0) / 2 + 0.5


def _cover(away: np.ndarray, width: float) -> np.ndarray:
    return np.float32(min(width, 1.0)) * np.clip(np.float32(_half(width)) - away, 0, 1)


def _distances(starts: np.ndarray, ends: np.ndarray, reach: int) -> np.ndarray:
    """From segments, (m, 2) each, to the pixels within `reach` of the origin, (m, side, side), float32."""
    square = np.arange(-reach, reach + 1, dtype=np.float32)
    start = starts.astype(np.float32)
    along = (ends - starts).astype(np.float32)
    dx, dy = square - start[:, :1], square - start[:, 1:]
    inverse = 1 / np.maximum((along**2).sum(axis=1, keepdims=True), np.float32(1e-12))
    t = (dy * along[:, 1:] * inverse)[:, :, None] + (dx * along[:, :1] * inverse)[:, None, :]
    np.maximum(np.minimum(t, 1, out=t), 0, out=t)
    across = dx[:, None, :] - t * along[:, 0, None, None]
    down = np.subtract(dy[:, :, None], np.multiply(t, along[:, 1, None, None], out=t), out=t)
    across *= across
    down *= down
    across += down
    return np.sqrt(across, out=across)


def dashes(line: np.ndarray, on: float, off: float) -> list[np.ndarray]:
    """Cut a polyline, shape (n, 2), into dashes of length `on` with gaps `off`, both along the line."""
    line = np.asarray(line, float)
    steps = np.hypot(*np.diff(line, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    if not 0 < arc[-1] < np.inf:
        return []
    if arc[-1] > _MOST_DASHES * (on + off):  # a runaway line: nobody could tell them apart
        return [line]
    cuts = []
    for begin in np.arange(0.0, arc[-1], on + off):
        end = min(begin + on, arc[-1])
        inner = line[(arc > begin) & (arc < end)]
        tips = np.column_stack([np.interp([begin, end], arc, line[:, axis]) for axis in (0, 1)])
        cuts.append(np.concatenate([tips[:1], inner, tips[1:]]))
    return cuts


def runs(line: np.ndarray, flags: np.ndarray, value: bool) -> list[np.ndarray]:
    """Parts of a polyline, shape (n, 2), whose flags, shape (n,), equal `value`.

    A step between two points counts as true when both of its ends are; so the two kinds meet without a gap.
    """
    line, flags = np.asarray(line, float), np.asarray(flags, bool)
    if len(flags) != len(line):
        raise ValueError(f"{len(line)} points but {len(flags)} flags")
    wanted = (flags[:-1] & flags[1:]) == value
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wanted, [False]]).astype(np.int8)))
    return [line[first : last + 1] for first, last in zip(edges[::2], edges[1::2], strict=True)]


def _pieces(lines: Polylines, size: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends, shape (m, 2) each, of pieces at most _PIECE long within `reach` of the image."""
    arrays = [np.asarray(line, float).reshape(-1, 2) for line in lines if len(line)]
    if not arrays:
        return np.zeros((0, 2)), np.zeros((0, 2))
    starts = np.concatenate([line[:-1] if len(line) > 1 else line for line in arrays])
    ends = np.concatenate([line[1:] if len(line) > 1 else line for line in arrays])
    finite = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
    starts, ends = _clipped(starts[finite], ends[finite], -float(reach), size + reach)
    along = ends - starts
    count = np.maximum(np.ceil(np.hypot(*along.T) / _PIECE), 1).astype(int)
    whole = np.repeat(np.arange(len(starts)), count)
    index = np.arange(len(whole)) - np.repeat(np.cumsum(count) - count, count)
    low, high = index / count[whole], (index + 1) / count[whole]
    return starts[whole] + low[:, None] * along[whole], starts[whole] + high[:, None] * along[whole]


def _clipped(starts: np.ndarray, ends: np.ndarray, low: float, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The parts of segments inside a box (Liang and Barsky); segments outside are dropped."""
    along = ends - starts
    safe = np.where(along == 0, 1e-30, along)
    to_low, to_high = (low - starts) / safe, (high - starts) / safe
    enter = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    leave = np.minimum(np.maximum(to_low, to_high).min(axis=1), 1.0)
    inside = enter <= leave
    starts, along = starts[inside], along[inside]
    return starts + enter[inside, None] * along, starts + leave[inside, None] * along
