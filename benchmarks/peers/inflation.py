"""Peer (c): the object's mask, blown up on both sides of the image plane.

The outline is the line of Otsu's grey value around the clicked axis. Heights h over the points inside it
solve -laplace(h^2) = 2, whose solution over a long straight strip is a round cylinder (`poisson`), or are
those of the union of all balls that fit inside the outline (`balls`).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay, KDTree
from skimage.draw import polygon2mask
from skimage.filters import threshold_otsu
from skimage.measure import find_contours, points_in_poly
from skimage.morphology import medial_axis

Mesh = tuple[np.ndarray, np.ndarray]


def poisson(image: np.ndarray, clicks: np.ndarray) -> Mesh | None:
    """Watertight mesh (V, 3), (F, 3) in pixels about depth 0; None where no line holds most of the axis."""
    outline = otsu_outline(image, clicks)
    if outline is None:
        return None
    points, triangles, border = _triangulated(outline)
    squared = _solve_poisson(points, triangles, border, 2.0)
    return _mirrored(points, triangles, border, np.sqrt(np.clip(squared, 0, None)))


def balls(image: np.ndarray, clicks: np.ndarray) -> Mesh | None:
    """The same with the balls around the points of the medial axis."""
    outline = otsu_outline(image, clicks)
    if outline is None:
        return None
    points, triangles, border = _triangulated(outline)
    corner, far = np.floor(outline.min(0)), np.ceil(outline.max(0))
    inside = polygon2mask(tuple((far - corner).astype(int) + 1)[::-1], (outline - corner)[:, ::-1])
    centres = np.argwhere(medial_axis(inside))[:, ::-1] + corner
    radius = KDTree(_evenly(outline, 0.25)).query(centres)[0]
    # the largest of r^2 - |p - c|^2
    squared = (2 * points @ centres.T + (radius**2 - (centres**2).sum(1))).max(1) - (points**2).sum(1)
    return _mirrored(points, triangles, border, np.sqrt(np.clip(squared, 0, None)))


def otsu_outline(image: np.ndarray, clicks: np.ndarray) -> np.ndarray | None:
    """Closed line (n, 2) of (column, row) that holds most of the axis, or None."""
    grey = gaussian_filter((image if image.ndim == 2 else image.mean(2)).astype(float), 1.0, mode="nearest")
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(clicks, axis=0), axis=1))])
    axis = CubicSpline(t, clicks)(np.linspace(0, t[-1], 50))
    lines = find_contours(grey, threshold_otsu(grey))
    closed = [line[:-1, ::-1] for line in lines if (line[0] == line[-1]).all()]
    held = [points_in_poly(axis, line).mean() for line in closed]
    return closed[int(np.argmax(held))] if held and max(held) > 0.5 else None


def _triangulated(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Points (n, 2), of which the first `border` lie on the outline, and triangles (m, 3) that fill it.

    Rows of points close to the outline carry the steep rim of the heights.
    """
    step = max(1.5, np.ptp(outline, axis=0).max() / 150)
    border = _evenly(outline, step)
    along = np.roll(border, -1, axis=0) - np.roll(border, 1, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
    near = KDTree(_evenly(outline, 0.25))
    rows = [border]
    for inset in (0.25 * step, step):
        row = np.concatenate([border + inset * across, border - inset * across])
        rows.append(_inside(row, border, near, 0.9 * inset))
    low, high = border.min(0), border.max(0)
    grid = np.meshgrid(np.arange(low[0], high[0], 2 * step), np.arange(low[1], high[1], 2 * step))
    rows.append(_inside(np.stack(grid, -1).reshape(-1, 2), border, near, 2 * step))
    points = np.concatenate(rows)
    triangles = Delaunay(points).simplices
    triangles = triangles[points_in_poly(points[triangles].mean(1), border)]
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return points, triangles, len(border)


def _inside(points: np.ndarray, border: np.ndarray, near: KDTree, distance: float) -> np.ndarray:
    """The points inside the outline and at least `distance` from it."""
    return points[points_in_poly(points, border) & (near.query(points)[0] >= distance)]


def _solve_poisson(points: np.ndarray, triangles: np.ndarray, border: int, load: float) -> np.ndarray:
    """The u (n,) with -laplace(u) = load inside and 0 on the border, by linear finite elements."""
    corner = points[triangles]
    edge = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)  # opposite each corner
    area = np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]) / 2
    local = np.einsum("tid,tjd->tij", edge, edge) / (4 * area)[:, None, None]
    i, j = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, 3).ravel()
    n = len(points)
    stiffness = coo_array((local.ravel(), (i, j)), shape=(n, n)).tocsc()
    right = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), n) * load
    inner = np.asarray(spsolve(stiffness[border:, border:], right[border:]))
    return np.concatenate([np.zeros(border), inner])


def _mirrored(points: np.ndarray, triangles: np.ndarray, border: int, height: np.ndarray) -> Mesh:
    """Two sheets at depth -height and +height, joined along the border."""
    height = np.where(np.arange(len(points)) < border, 0, height)
    front, back = np.column_stack([points, -height]), np.column_stack([points, height])[border:]
    behind = np.where(triangles < border, triangles, triangles + len(points) - border)
    # counter-clockwise in (X, Y) has its normal along +Z
    return np.concatenate([front, back]), np.concatenate([triangles[:, ::-1], behind])


def _evenly(loop: np.ndarray, spacing: float) -> np.ndarray:
    """The closed line (n, 2) resampled at about equal steps."""
    closed = np.concatenate([loop, loop[:1]])
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0, t[-1], max(int(t[-1] / spacing), 20), endpoint=False)
    return np.stack([np.interp(at, t, c) for c in closed.T], 1)
