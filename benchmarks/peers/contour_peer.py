"""Peer (a): the object's outline by scikit-image's active contour, plain and with help.

Plain: a smoothed image, one start around the clicked axis wide enough for every object, weights found by
trial on other shapes. Helped: the edge picture is the logarithm of the gradient's magnitude, whose pull
reaches far and does not depend on contrast; three steps from coarse to fine; and starts of several widths,
of which the one that comes to rest on the strongest edges goes on.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, gaussian_gradient_magnitude, map_coordinates
from skimage.segmentation import active_contour

WIDTH = 0.3
"""Offset of the plain contour's start from the axis, in lengths of the clicked line."""
WIDTHS = (0.1, 0.2, 0.35)
STEPS = ((4, 3.0, 0.2, 0.1, 150), (2, 2.0, 0.01, 0.05, 100), (1, 1.5, 0.002, 0.02, 100))
"""Shrinkage of the image, smoothing [px of that image], alpha, beta, iterations."""


def plain(image: np.ndarray, clicks: np.ndarray) -> np.ndarray:
    """Closed outline (n, 2) of (column, row) points around an axis (k, 2), from a grey or colour image."""
    grey = image if image.ndim == 2 else image.mean(2)
    # the weights hold for a spacing of 3 px and a smoothing of 3 px at 512 px: larger images are shrunk
    shrink = max(1, round(max(grey.shape) / 512))
    start = _evenly(_capsule(_extended(clicks), WIDTH * _length(clicks)), 3.0 * shrink)
    end = active_contour(
        gaussian_filter(_shrunk(grey, shrink), 3.0, mode="nearest"),
        _to_small(start, shrink)[:, ::-1],
        alpha=0.1,
        beta=0.1,
        w_line=0,
        w_edge=10,
        gamma=0.05,
        max_num_iter=2500,
        convergence=0.02,
    )
    return _to_full(end[:, ::-1], shrink)


def helped(image: np.ndarray, clicks: np.ndarray) -> np.ndarray:
    """The same by the best use of the function that we found."""
    grey = image if image.ndim == 2 else image.mean(2)
    axis, (first, *finer) = _extended(clicks), STEPS
    tried = [_relax(grey, _capsule(axis, width * _length(clicks)), *first) for width in WIDTHS]
    snake = max(tried, key=lambda s: _edge_strength(grey, s))
    for step in finer:
        snake = _relax(grey, snake, *step)
    return snake


def _relax(
    grey: np.ndarray,
    snake: np.ndarray,
    shrink: int,
    sigma: float,
    alpha: float,
    beta: float,
    steps: int,
) -> np.ndarray:
    """The contour (n, 2) at rest on the edges of the image at one scale."""
    small = _shrunk(grey, shrink)
    edges = gaussian_gradient_magnitude(small, sigma, mode="nearest")
    picture = np.log(edges / edges.max() + 0.03)
    start = _to_small(_evenly(snake, 2.0 * shrink), shrink)
    end = active_contour(
        picture,
        start[:, ::-1],
        alpha=alpha,
        beta=beta,
        w_line=1,
        w_edge=0,
        gamma=0.3,
        max_num_iter=steps,
        convergence=0.02,
    )
    return _to_full(end[:, ::-1], shrink)


def _shrunk(grey: np.ndarray, by: int) -> np.ndarray:
    """Means over squares of by x by pixels."""
    h, w = grey.shape[0] // by * by, grey.shape[1] // by * by
    return grey[:h, :w].reshape(h // by, by, w // by, by).mean((1, 3))


def _to_small(points: np.ndarray, by: int) -> np.ndarray:
    return (points + 0.5) / by - 0.5


def _to_full(points: np.ndarray, by: int) -> np.ndarray:
    return (points + 0.5) * by - 0.5


def _length(line: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _edge_strength(grey: np.ndarray, snake: np.ndarray) -> float:
    edges = gaussian_gradient_magnitude(grey, 4.0, mode="nearest")
    return float(map_coordinates(edges, _evenly(snake, 2.0).T[::-1], order=1, mode="nearest").mean())


def _extended(clicks: np.ndarray, beyond: float = 0.15, count: int = 60) -> np.ndarray:
    """Points along a spline through the clicks, lengthened at both ends by a share of its length."""
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(clicks, axis=0), axis=1))])
    line = CubicSpline(t, clicks)(np.linspace(0, t[-1], count))
    step = beyond * t[-1]
    ends = [line[0] - line[2], line[-1] - line[-3]]
    first, last = (line[k] + step * d / np.linalg.norm(d) for k, d in zip((0, -1), ends, strict=True))
    return np.concatenate([[first], line, [last]])


def _capsule(axis: np.ndarray, radius: float) -> np.ndarray:
    """Outline (n, 2) of all points nearer to the axis (k, 2) than `radius`, taken as one loop around it."""
    tangent = np.gradient(axis, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.linspace(0, np.pi, 20)[1:-1, None]
    ahead = np.stack([normal[:, 1], -normal[:, 0]], 1)
    end = np.cos(angle) * normal[-1] + np.sin(angle) * ahead[-1]
    start = -np.cos(angle) * normal[0] - np.sin(angle) * ahead[0]
    sides = axis + radius * normal, (axis - radius * normal)[::-1]
    return np.concatenate([sides[0], axis[-1] + radius * end, sides[1], axis[0] + radius * start])


def _evenly(loop: np.ndarray, spacing: float) -> np.ndarray:
    """The closed line (n, 2) resampled at about equal steps."""
    closed = np.concatenate([loop, loop[:1]])
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0, t[-1], max(int(t[-1] / spacing), 20), endpoint=False)
    return np.stack([np.interp(at, t, c) for c in closed.T], 1)
