"""The most likely ribbon about a rough axis: colours say what lies in it, edges where it ends, both sides alike.

A ribbon has a centre and a half width at each station across the axis; the best of all is found by dynamic programming.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.draw import polygon

STATION, GRAIN = 4.0, 2.0
"""Between two stations along the axis, between two offsets across it [samples]."""
ASIDE, WIDEST = 9, 28
"""Farthest that the centre may lie beside the axis, greatest half width, in grains."""
BEYOND = 0.15
"""How far past each end of the axis is looked, in lengths of the axis."""
SAY = 1.0
"""Most that one sample's colour may say, as log odds."""
EDGE = 20.0
"""What the strongest edges at both ends of a station are worth, in samples of plain colour."""
SWAY, SWELL = 6.0, 6.0
"""Cost of a grain by which centre and half width change from one station to the next, in samples of plain colour."""
SHIFT, GROW = 1, 3
"""Most by which centre and half width change from one station to the next, in grains."""


def ribbon(x: np.ndarray, odds: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The best ribbon and its centre line.

    Args:
        x: image, shape (h, w, channels).
        odds: log odds that each sample's colour is the object's, shape (h, w).
        line: axis in even steps, shape (n, 2), samples (column, row).

    Returns:
        mask, shape (h, w), bool; centre line along the axis, shape (m, 2), samples.
    """
    points, normal, lead = _stations(line)
    offset = GRAIN * np.arange(-ASIDE - WIDEST, ASIDE + WIDEST + 1)
    at = (points[:, None] + offset[:, None] * normal[:, None]).transpose(2, 0, 1)[::-1]
    said = ndimage.map_coordinates(np.clip(odds, -SAY, SAY), at, order=1, mode="constant")
    soft = ndimage.gaussian_filter(x, (1, 1, 0))
    across = np.stack([ndimage.map_coordinates(c, at, order=1, mode="nearest") for c in np.moveaxis(soft, -1, 0)], -1)
    edge = np.linalg.norm(np.gradient(across, axis=1), axis=-1)
    edge = np.minimum(edge / (np.quantile(edge, 0.95) + 1e-12), 1.0)
    centre, half = _best(said, edge)
    middle = points + GRAIN * centre[:, None] * normal
    sides = [middle + s * GRAIN * half[:, None] * normal for s in (-1, 1)]
    mask = np.zeros(x.shape[:2], bool)
    for a, b, c, d in zip(sides[0][:-1], sides[0][1:], sides[1][1:], sides[1][:-1], strict=True):
        corners = np.stack([a, b, c, d])
        mask[polygon(corners[:, 1], corners[:, 0], mask.shape)] = True
    smooth = points + GRAIN * ndimage.gaussian_filter1d(centre.astype(float), 12 / STATION)[:, None] * normal
    return mask, smooth[lead : len(smooth) - lead]


def _stations(line: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Points and normals, shape (m, 2) each, along the axis carried on straight; how many lie before the axis."""
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = max(8, round(arc[-1] / STATION))
    points = np.stack([np.interp(np.linspace(0, arc[-1], count), arc, c) for c in line.T], axis=1)
    lead, quarter = round(BEYOND * count), count // 4
    run = np.arange(1, lead + 1)[:, None] / quarter
    first, last = points[0] - points[quarter], points[-1] - points[-1 - quarter]
    points = np.concatenate([points[0] + run[::-1] * first, points, points[-1] + run * last])
    tangent = ndimage.gaussian_filter1d(np.gradient(points, axis=0), 2, axis=0, mode="nearest")
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    return points, np.stack([-tangent[:, 1], tangent[:, 0]], axis=1), lead


def _best(said: np.ndarray, edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half width of the best ribbon at each station [grains], from log odds and edges, shape (m, offsets)."""
    total = np.cumsum(said, axis=1) - said / 2
    c, w = np.arange(-ASIDE, ASIDE + 1)[:, None], np.arange(WIDEST + 1)[None]
    left, right = c - w + ASIDE + WIDEST, c + w + ASIDE + WIDEST
    worth = 2 * GRAIN * (total[:, right] - total[:, left]) + EDGE * (edge[:, left] + edge[:, right]) * (w > 0)
    worth *= STATION / 2
    bests = [worth[0]]
    for gain in worth[1:]:
        bests.append(_over(_over(bests[-1], GROW, SWELL, 1), SHIFT, SWAY, 0) + gain)
    i, j = np.unravel_index(int(bests[-1].argmax()), bests[-1].shape)
    path = [(i, j)]
    for best in bests[-2::-1]:
        rows, cols = np.arange(max(i - SHIFT, 0), i + SHIFT + 1), np.arange(max(j - GROW, 0), j + GROW + 1)
        ways = best[rows[0] : i + SHIFT + 1, cols[0] : j + GROW + 1]
        ways = ways - SWAY * abs(rows - i)[: ways.shape[0], None] - SWELL * abs(cols - j)[: ways.shape[1]]
        di, dj = np.unravel_index(int(ways.argmax()), ways.shape)
        i, j = rows[di], cols[dj]
        path.append((i, j))
    centre, half = np.array(path[::-1]).T
    return centre - ASIDE, half


def _over(best: np.ndarray, most: int, cost: float, axis: int) -> np.ndarray:
    """Best within `most` grains along an axis, each at a cost."""
    best = np.moveaxis(best, axis, 0)
    out = best.copy()
    for k in range(1, most + 1):
        np.maximum(out[k:], best[:-k] - k * cost, out=out[k:])
        np.maximum(out[:-k], best[k:] - k * cost, out=out[:-k])
    return np.moveaxis(out, 0, axis)
