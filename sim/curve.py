"""Curves through nodes: smooth points between them, even spacing, sense of rotation, borders of grids."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from .camera import Camera
from .foreground import length_of
from .initial import lift
from .problem import Sheet, Snake


def first_nodes(o: Snake | Sheet, camera: Camera) -> np.ndarray:
    """First nodes (N_x, N_s, 3): of a snake image px, of a sheet in the world."""
    if isinstance(o, Snake):
        points = oriented(np.asarray(o.points, float)) if o.closed else np.asarray(o.points, float)
        line = np.concatenate([points, points[:1]]) if o.closed else points
        t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        want = np.linspace(0, t[-1], o.nodes, endpoint=not o.closed)
        return np.stack([np.interp(want, t, line[:, 0]), np.interp(want, t, line[:, 1]), 0 * want], axis=1)[:, None]
    corners = np.asarray(o.corners, float)
    if corners.shape[1] == 2:
        corners = lift(corners, camera, o.depth)
    a, b, c, d = corners
    x, s = (np.linspace(0, 1, n) for n in o.grid)
    x, s = x[:, None, None], s[None, :, None]
    return (1 - s) * ((1 - x) * a + x * b) + s * ((1 - x) * d + x * c)


def between(n: int, closed: bool, each: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the smooth curve (Catmull-Rom) through n nodes, `each` between two: indices and weights, (m, 4) each.

    Weights are those of the place and of the direction. At an open end the third difference is taken as zero.
    """
    t = (np.arange(each) + 0.5) / each
    place = 0.5 * np.stack([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2], axis=1)
    way = 0.5 * np.stack([-1 + 4 * t - 3 * t**2, -10 * t + 9 * t**2, 1 + 8 * t - 9 * t**2, 3 * t**2 - 2 * t], axis=1)
    first = np.repeat(np.arange(n if closed else n - 1), each)
    at = first[:, None] + np.arange(-1, 3)
    place, way = (np.tile(w, (len(first) // each, 1)) for w in (place, way))
    if closed:
        return at % n, place, way
    for low, from_, to in ((at[:, 0] < 0, 0, (1, 2, 3)), (at[:, 3] >= n, 3, (2, 1, 0))):
        for w in (place, way):
            for node, factor in zip(to, (3.0, -3.0, 1.0), strict=True):
                w[low, node] += factor * w[low, from_]
            w[low, from_] = 0.0
    return np.clip(at, 0, n - 1), place, way


def shoelace(points: np.ndarray) -> float:
    """Area within a closed polygon, shape (n, 2); above 0 where it runs clockwise as an image is seen."""
    x, y = points.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def oriented(points: np.ndarray) -> np.ndarray:
    """A closed polygon, shape (n, 2), that runs clockwise as an image is seen."""
    return points if shoelace(points) > 0 else points[::-1]


def evenly(curve: np.ndarray, count: int, closed: bool) -> np.ndarray:
    """Points at even distances along the smooth curve through nodes, shape (count, d)."""
    nodes = np.concatenate([curve, curve[:1]]) if closed else curve
    spline = CubicSpline(np.arange(len(nodes)), nodes, bc_type="periodic" if closed else "not-a-knot")
    fine = np.linspace(0, len(nodes) - 1, 20 * len(nodes))
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(spline(fine), axis=0), axis=1))])
    return spline(np.interp(np.linspace(0, t[-1], count, endpoint=not closed), t, fine))


def border(v: np.ndarray) -> np.ndarray:
    """Border nodes of a sheet (N_x, N_s, 3) in order around it, shape (n, 3)."""
    return np.concatenate([v[:-1, 0], v[-1, :-1], v[:0:-1, -1], v[0, :0:-1]])


def size(v: np.ndarray, closed: bool) -> float:
    """Length of a snake, or mean length of a sheet's two middle lines; nodes (N_x, N_s, 3)."""
    if v.shape[1] == 1:
        line = v[:, 0]
        return length_of(np.concatenate([line, line[:1]]) if closed else line)
    return 0.5 * (length_of(v[:, v.shape[1] // 2]) + length_of(v[v.shape[0] // 2]))
