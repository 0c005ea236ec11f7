"""What several views say together: how they share out their pull, and where an axis that all of them see lies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from .camera import Camera
from .foreground import axis_curve

BLIND = 1e-4
"""Stiffness of the weakest direction, over that of the stiffest, below which no view tells it."""
DEGREE = 5
"""Of the way, a polynomial along it, from a rough axis to the one that all views agree about."""
MOST = 15
"""Of a rough axis itself: as many as it is widths of the object long, no fewer than the way's."""
ROUGH = 3
"""Of an axis by what was clicked."""
ROUNDS = 10
TOLD, UNTOLD = np.radians(45.0), np.radians(120.0)
"""Gaps between contours around a section that tell, and do not tell, how it differs from a circle."""
ASIDE = 0.5
"""Sine of the angle between sight and spine from which on a view shows the section's contour."""
TIPS = 20.0
"""Weight of an axis' ends, which say where along it a point lies, against all else that lies across it."""
RIDGE = 2e-6
"""How firmly an axis is kept straight where the views say nothing: clicks are off by most in depth."""


def pixel_size(camera: Camera, point: np.ndarray, step: float) -> float:
    """World length of an image pixel at a point, shape (3,), found by a world step."""
    return step / float(np.linalg.norm(camera.project(point + step * np.eye(3)) - camera.project(point), axis=1).max())


def stiffness(sights: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of all views together, the sum of weight (1 - i i^T), along its axes: rising, (n, 3), and columns (n, 3, 3).

    Arguments as for `spread`.
    """
    planes = np.eye(3) - sights[..., :, None] * sights[..., None, :]
    return np.linalg.eigh((weights[..., None, None] * planes).sum(axis=1))


def spread(sights: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What makes the pull of all views, each within its image plane, as stiff in every direction as one view's is in two.

    It is the inverse of the sum over views of weight (1 - i i^T), so that depth, of which a pair of eyes that look almost
    the same way says little, converges as fast as the rest.

    Args:
        sights: unit lines of sight i to each place, shape (n, V, 3).
        weights: of the views, shape (n, V).

    Returns:
        Symmetric matrices for each view's force times its weight at a node, shape (n, 3, 3); those for what the sum over
        a ring lacks in the weakest direction, to be added for all views and nodes at once, shape (n, 3, 3); whether the
        views tell every direction, shape (n,), bool.
    """
    value, axes = stiffness(sights, weights)
    told = value[:, 0] > BLIND * value[:, 2]
    value[~told, 0] = value[~told, 1]
    weakest = axes[:, :, :1]
    lacking = (value[:, 1] / value[:, 0] - 1)[:, None, None] * weakest @ weakest.transpose(0, 2, 1)
    value[:, 0] = value[:, 1]
    return (axes / value[:, None]) @ axes.transpose(0, 2, 1), lacking, told


def untold(sights: np.ndarray, spine: np.ndarray) -> np.ndarray:
    """How much of a ring's section the views leave to symmetry, by the widest gap between their contours around it.

    Each view shows two points of the section, at right angles to its sight. A gap of `UNTOLD` and more says nothing of
    ovals, one of `TOLD` and less all of them.

    Args:
        sights: unit lines of sight i to each ring, shape (n, V, 3).
        spine: shape (n, 3).

    Returns:
        shape (n,), 0 to 1.
    """
    tangent = np.gradient(spine, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    edge = np.cross(sights, tangent[:, None])
    aside = np.linalg.norm(edge, axis=2)
    across = np.cross(tangent, edge[np.arange(len(edge)), aside.argmax(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(across, tangent)
    angle = np.arctan2((edge * across[:, None]).sum(axis=2), (edge * along[:, None]).sum(axis=2)) % np.pi
    angle = np.where(aside > ASIDE, angle, angle[np.arange(len(edge)), aside.argmax(axis=1)][:, None])
    angle = np.sort(angle, axis=1)
    gap = np.diff(angle, axis=1, append=angle[:, :1] + np.pi).max(axis=1)
    return np.clip((gap - TOLD) / (UNTOLD - TOLD), 0.0, 1.0)


def common_axis(
    rough: np.ndarray, cameras: Sequence[Camera], seen: Sequence[np.ndarray], slender: float = DEGREE
) -> np.ndarray:
    """The axis in the world that lies, in each view, on the axis seen there, and ends where that ends.

    Clicks that are off by little put a zigzag of depth into the rough axis, in which rings would cross: where it bends
    within a width of the object it is smoothed.

    Args:
        rough: rough axis, shape (n, 3).
        cameras: of the views.
        seen: axis of the object in each view, from end to end, shape (m, 2) each, image points.
        slender: length of the object in its widths.

    Returns:
        shape (n, 3), evenly spaced.
    """
    axis = axis_curve(rough)
    length = float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum())
    long = np.concatenate([2 * axis[0] - axis[:0:-1], axis, 2 * axis[-1] - axis[-2::-1]])
    slope = np.gradient(long, axis=0)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    # the views vote on where it ends, those that see it from the side
    ends = []
    for end in (0, -1):
        vote = np.zeros((len(cameras), 2))
        for v, (camera, line) in enumerate(zip(cameras, seen, strict=True)):
            at = int(((camera.project(long) - line[end]) ** 2).sum(axis=1).argmin())
            vote[v] = at, _aside(camera, long, slope)[at]
        ends.append(int(np.rint(np.average(vote[:, 0], weights=vote[:, 1] + 1e-9))))
    first, last = min(ends[0], ends[1] - 10), max(ends[1], ends[0] + 10)
    axis = axis_curve(long[max(first, 0) : last + 1])
    basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(axis)), int(np.clip(round(slender), DEGREE, MOST)))
    axis = basis @ np.linalg.lstsq(basis, axis, rcond=None)[0]
    basis, degree = basis[:, : DEGREE + 1], np.arange(DEGREE + 1.0)
    ridge = RIDGE * len(axis) * np.kron(np.diag(np.where(degree < 2, 0.0, degree**4)), np.eye(3))
    bend = np.linalg.lstsq(basis, axis, rcond=None)[0].ravel()
    start, way, lines = axis, np.zeros(3 * (DEGREE + 1)), [KDTree(line) for line in seen]
    for _ in range(ROUNDS):
        slope = np.gradient(axis, axis=0)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        normal, right = ridge.copy(), -ridge @ (bend + way)
        for camera, line in zip(cameras, lines, strict=True):
            rows, gaps = _pull(camera, axis, line, np.sqrt(_aside(camera, axis, slope)), 1e-4 * length)
            full = (rows[:, :, None, :] * basis[:, None, :, None]).reshape(-1, 3 * (DEGREE + 1))
            normal += full.T @ full
            right += full.T @ gaps.ravel()
        way = way + np.linalg.solve(normal, right)
        axis = start + basis @ way.reshape(DEGREE + 1, 3)
    return axis_curve(axis)


def _aside(camera: Camera, points: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """How much from the side a view sees a curve at its points, 0 to 1: square of the sine of the angle, shape (n,)."""
    return 1 - (camera.sight(points) * slope).sum(axis=1) ** 2


def _pull(camera: Camera, axis: np.ndarray, seen: KDTree, weight: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear equations that bring an axis onto the one seen: rows (n, 2, 3), right sides (n, 2), in world lengths."""
    p = camera.project(axis)
    jacobian = np.stack([camera.project(axis + step * e) - p for e in np.eye(3)], axis=2) / step
    pixel = 1 / np.linalg.norm(jacobian, axis=(1, 2))
    line, at = np.asarray(seen.data), np.asarray(seen.query(p)[1])
    at[[0, -1]] = 0, len(line) - 1
    along = np.gradient(line, axis=0)[at]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    scale = weight * pixel
    scale[[0, -1]] *= TIPS * weight[[0, -1]]
    sides = np.stack([across, np.zeros_like(along)], axis=1)
    sides[[0, -1], 1] = along[[0, -1]]
    sides *= scale[:, None, None]
    return sides @ jacobian, (sides * (line[at] - p)[:, None]).sum(axis=2)


def meeting(points: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """World points, shape (n, 3), that come closest to being seen at image points, shape (n, 2) in each view."""
    sides, heights = [], []
    for camera, flat in zip(cameras, points, strict=True):
        m = camera.matrix
        size = 1 / np.linalg.norm(m[:2, :3])
        sides.append(size * (m[:2, :3] - flat[..., None] * m[2, :3]))
        heights.append(size * (flat * m[2, 3] - m[:2, 3]))
    side, height = np.concatenate(sides, axis=1), np.concatenate(heights, axis=1)
    return np.stack([np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(side, height, strict=True)])


def triangulated(axes: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """A rough axis in the world from rough axes in two or more views, end to end the same way.

    Points at the same share of each axis' length meet at first; what lies across the axes then corrects that.

    Args:
        axes: shape (n, 2) each, image points.
        cameras: of their views.

    Returns:
        shape (200, 3).
    """
    seen = [axis_curve(a) for a in axes]
    points = meeting(seen, cameras)
    basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(points)), ROUGH)
    smooth = basis @ np.linalg.lstsq(basis, points, rcond=None)[0]
    return common_axis(smooth, cameras, seen)
