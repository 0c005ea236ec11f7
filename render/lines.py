"""Anti-aliased lines of any width at sub-pixel positions: coverage follows from the distance to the line.

Points are (column, row) of the image drawn into, pixel centres at whole numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Polylines = Sequence[np.ndarray]
Colour = tuple[int, int, int]

_PIECE = 4.0  # px; long lines are cut so that a small square of pixels serves each piece
_CHUNK = 4_000_000  # pixels looked at in one go, which bounds the memory


def stroke(image: np.ndarray, lines: Polylines, colour: Colour, width: float, alpha: float = 1.0) -> None:
    """Draw polylines with round caps and joins, in place; where they cross, nothing is drawn twice.

    Args:
        image: shape (H, W, 3), uint8, C-contiguous.
        lines: each of shape (n, 2), n >= 1, px; parts with points that are not finite are left out.
        colour: RGB, 0 to 255.
        width: px; below one the line fades instead.
        alpha: opacity, 0 to 1.

    Raises:
        ValueError: the image is not writable in place.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or not image.flags.c_contiguous:
        raise ValueError(f"image must be C-contiguous uint8 (H, W, 3), not {image.dtype} {image.shape}")
    cover = coverage(lines, width, image.shape[:2]).ravel()
    where = np.flatnonzero(cover)
    pixels = image.reshape(-1, 3)
    under = pixels[where].astype(np.float32)
    share = alpha * cover[where, None]
    pixels[where] = np.rint(under + share * (np.asarray(colour, np.float32) - under))


def coverage(lines: Polylines, width: float, shape: tuple[int, int]) -> np.ndarray:
    """Share of each pixel that the lines cover, shape (H, W), float32 in [0, 1]."""
    height, breadth = shape
    cover = np.zeros(height * breadth, np.float32)
    peak, half = min(width, 1.0), max(width, 1.0) / 2 + 0.5
    reach = int(np.ceil(_PIECE / 2 + half)) + 1
    starts, ends = _pieces(lines, np.array([breadth, height], float), reach)
    square = np.arange(-reach, reach + 1, dtype=np.float32)
    per_chunk = max(1, _CHUNK // len(square) ** 2)
    for first in range(0, len(starts), per_chunk):
        start, end = starts[first : first + per_chunk], ends[first : first + per_chunk]
        middle = np.rint((start + end) / 2)
        start, along = (start - middle).astype(np.float32), (end - start).astype(np.float32)
        # distance from each pixel of the square (row i, column j) to its piece
        dx = square[None, None, :] - start[:, 0, None, None]
        dy = square[None, :, None] - start[:, 1, None, None]
        ax, ay = along[:, 0, None, None], along[:, 1, None, None]
        t = np.clip((dx * ax + dy * ay) / np.maximum(ax * ax + ay * ay, 1e-12), 0.0, 1.0)
        share = peak * np.clip(half - np.hypot(dx - t * ax, dy - t * ay), 0.0, 1.0)
        offsets = square.astype(np.int64)
        column = middle[:, 0, None, None].astype(np.int64) + offsets[None, None, :]
        row = middle[:, 1, None, None].astype(np.int64) + offsets[None, :, None]
        keep = (share > 0) & (column >= 0) & (column < breadth) & (row >= 0) & (row < height)
        np.maximum.at(cover, (row * breadth + column)[keep], share[keep])
    return cover.reshape(shape)


def dashes(line: np.ndarray, on: float, off: float) -> list[np.ndarray]:
    """Cut a polyline, shape (n, 2), into dashes of length `on` with gaps `off`, both along the line."""
    line = np.asarray(line, float)
    steps = np.hypot(*np.diff(line, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    if not 0 < arc[-1] < np.inf:
        return []
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


def _clipped(
    starts: np.ndarray, ends: np.ndarray, low: float, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The parts of segments inside a box (Liang and Barsky); segments outside are dropped."""
    along = ends - starts
    safe = np.where(along == 0, 1e-30, along)
    to_low, to_high = (low - starts) / safe, (high - starts) / safe
    enter = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    leave = np.minimum(np.maximum(to_low, to_high).min(axis=1), 1.0)
    inside = enter <= leave
    starts, along = starts[inside], along[inside]
    return starts + enter[inside, None] * along, starts + leave[inside, None] * along
