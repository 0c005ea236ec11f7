"""Rigid first, then deformable (section 4.3): a few moves of the whole tube, as a rigid body or as a rod that bends.

Each ring moves rigidly, by c + w x (p - spine), with c and w polynomials along the spine; of degree 0 all of the tube does,
about its middle. What the contours of all views are off by, least squares make up for (Gauss and Newton).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from .camera import Camera
from .hidden import Hidden
from .potential import Potential

ROD = 1.0
"""Weight of a rod's kinematics, dc/ds = w x dv/ds: it neither stretches nor leaves its rings behind; against pixels."""
TWIST = 0.3
"""Weight of a ring's turn about the spine, which outlines hardly tell, likewise."""
STEADY = 1e-3
"""Least stiffness, over the mean one: of what no view tells."""


@dataclass(frozen=True)
class Outline:
    """Points of a tube's occluding contour in one view, and how far from the edges they are."""

    at: np.ndarray
    """place along s [rings], shape (n,)."""
    points: np.ndarray
    """shape (n, 3)."""
    slope: np.ndarray
    """derivative of their place across the contour in the image by their place in space, shape (n, 3)."""
    way: np.ndarray
    """across the contour to its edge [image px], shape (n,)."""
    share: np.ndarray
    """of the contour that each stands for, shape (n,)."""


@threadpool_limits.wrap(limits=1, user_api="blas")  # sharing small matrices between threads is slower
def bend(
    tube: np.ndarray,
    spine: np.ndarray,
    cameras: Sequence[Camera],
    potentials: Sequence[Potential],
    sizes: Sequence[tuple[int, ...]],
    degree: int,
    closed: bool = True,
    hidden: Sequence[Hidden | None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The tube moved to where all views' contours lie better on their edges, to first order.

    Args:
        tube: shape (N_x, N_s, 3).
        spine: shape (N_s, 3).
        cameras, potentials, sizes: of the views, cameras in the tube's units, sizes (height, width) of their images.
        degree: of the polynomials; 0: a rigid body.
        closed: end rings are points.
        hidden: where nothing is to be looked at in each view.

    Returns:
        tube, spine.
    """
    place = np.append(0.0, np.cumsum(_length(np.diff(spine, axis=0))))
    length = place[-1]
    if not length > 0:
        return tube, spine
    u = 2 * place / length - 1
    basis = np.polynomial.legendre.legvander(u, degree)
    pivot = spine if degree > 0 else np.broadcast_to(spine.mean(axis=0), spine.shape)
    rows, off = [], []
    for seen in outlines(tube, cameras, potentials, sizes, closed, hidden):
        if len(seen.at):
            root = np.sqrt(seen.share)
            own = np.concatenate([seen.slope, cross(seen.points - _between(pivot, seen.at), seen.slope)], axis=1)
            own *= root[:, None]
            rows.append((_between(basis, seen.at)[:, :, None] * own[:, None]).reshape(len(own), -1))
            off.append(root * seen.way)
    if not rows:
        return tube, spine
    a, d = np.concatenate(rows), np.concatenate(off)
    scale = np.sqrt((a[:, :3] ** 2).sum() / 3)  # pixels for a unit of length
    # w in radians, c in lengths: as far as both move a ring's contour about as much
    if degree > 0:
        legendre = np.polynomial.legendre.legder(np.eye(degree + 1))
        slope = np.polynomial.legendre.legval(u, legendre).T
        tangent = np.gradient(spine, u, axis=0)
        turn = np.stack([cross(e, tangent) for e in np.eye(3)], axis=2)
        free = np.concatenate(
            [slope[:, None, :, None] * np.eye(3)[None, :, None], -basis[:, None, :, None] * turn[:, :, None]], axis=3
        )
        weight = ROD * scale / np.sqrt(len(u))
        spin = tangent / np.maximum(_length(tangent), 1e-30)[:, None]
        spin *= TWIST * _length(tube - spine).mean(axis=0)[:, None]
        about = basis[:, :, None, None] * np.stack([np.zeros_like(spin), spin], axis=1)[:, None]
        a = np.concatenate([a, weight * free.reshape(-1, a.shape[1]), weight * about.reshape(-1, a.shape[1])])
        d = np.append(d, np.zeros(len(a) - len(d)))
    grow = np.repeat((1.0 + np.arange(degree + 1)) ** 2, 6)
    size = np.tile(np.repeat([1.0, 0.5 * length], 3), degree + 1)
    matrix = a.T @ a + STEADY * scale**2 * np.diag(grow * size**2)
    x = np.linalg.solve(matrix, a.T @ d).reshape(degree + 1, 6)
    step, turn = basis @ x[:, :3], basis @ x[:, 3:]
    return pivot + step + _turned(tube - pivot, turn), pivot + step + _turned((spine - pivot)[None], turn)[0]


def outlines(
    tube: np.ndarray,
    cameras: Sequence[Camera],
    potentials: Sequence[Potential],
    sizes: Sequence[tuple[int, ...]],
    closed: bool,
    hidden: Sequence[Hidden | None] | None = None,
) -> list[Outline]:
    """Where the occluding contour i.n = 0 crosses the grid's lines in each view, within its image and not hidden.

    Args as `bend`.
    """
    around, along = np.roll(tube, -1, axis=0) - np.roll(tube, 1, axis=0), np.gradient(tube, axis=1)
    normal = cross(around, along)
    if closed:
        normal[:, 0], normal[:, -1] = -along[:, 0].mean(axis=0), along[:, -1].mean(axis=0)
    normal /= np.maximum(_length(normal), 1e-30)[..., None]
    views = zip(cameras, potentials, sizes, hidden or [None] * len(cameras), strict=True)
    return [_outline(tube, normal, camera, potential, size, closed, hides) for camera, potential, size, hides in views]


def _outline(
    tube: np.ndarray,
    normal: np.ndarray,
    camera: Camera,
    potential: Potential,
    size: tuple[int, ...],
    closed: bool,
    hidden: Hidden | None,
) -> Outline:
    count, rings = tube.shape[:2]
    facing = np.einsum("xsi,xsi->xs", camera.sight(tube), normal)
    front = facing >= 0
    i, j = np.nonzero(front != np.roll(front, -1, axis=0))
    if closed:
        i, j = i[(j > 0) & (j < rings - 1)], j[(j > 0) & (j < rings - 1)]
    k, m = np.nonzero(front[:, :-1] != front[:, 1:])
    # the edges crossed, from a node to the next around and to the next along, and their neighbours on both sides
    rows, columns = np.concatenate([i, k]), np.concatenate([j, m])
    rows2, columns2 = np.concatenate([(i + 1) % count, k]), np.concatenate([j, m + 1])
    a, b = facing[rows, columns], facing[rows2, columns2]
    t = a / (a - b)
    point = tube[rows, columns] + t[:, None] * (tube[rows2, columns2] - tube[rows, columns])
    n = normal[rows, columns] + t[:, None] * (normal[rows2, columns2] - normal[rows, columns])
    # a share is the length across the line that is crossed
    flat = camera.project(tube)
    one = flat[np.concatenate([i, (k + 1) % count]), np.concatenate([np.minimum(j + 1, rings - 1), m])]
    other = flat[np.concatenate([i, k - 1]), np.concatenate([np.maximum(j - 1, 0), m])]
    long = _length(one - other)
    pixels, slope = linearised(camera, point)
    seen = ((pixels >= 0) & (pixels <= np.array(size[1::-1]) - 1)).all(axis=1)
    if hidden is not None:
        seen &= ~hidden.at(pixels)
    at = columns + t * (np.arange(len(t)) >= len(i))
    at, point, pixels, slope, n, long = at[seen], point[seen], pixels[seen], slope[seen], n[seen], long[seen]
    across = np.einsum("nij,nj->ni", slope, n)
    across /= np.maximum(_length(across), 1e-30)[:, None]
    value = look_up(potential, pixels)
    way = (value[:, :2] * across).sum(axis=1) + value[:, 2]
    return Outline(at, point, np.einsum("ni,nij->nj", across, slope), way, long / max(long.sum(), 1e-30))


def linearised(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image points (n, 2) of world points (n, 3), and their derivative (n, 2, 3)."""
    m = camera.matrix
    flat = camera.project(points)
    depth = points @ m[2, :3] + m[2, 3]
    return flat, (m[None, :2, :3] - flat[..., None] * m[2, :3]) / depth[:, None, None]


def look_up(potential: Potential, points: np.ndarray) -> np.ndarray:
    """Samples at image points (n, 2), bilinear, the border's beyond it; shape (n, 4)."""
    samples = potential.samples
    last = np.array(samples.shape[1::-1]) - 1
    at = np.clip((points - np.array(potential.origin)) / potential.step, 0, last)
    column, row = np.minimum(at.astype(int), last - 1).T
    x, y = (at - np.stack([column, row], axis=1)).T[..., None]
    top = samples[row, column] * (1 - x) + samples[row, column + 1] * x
    return top * (1 - y) + (samples[row + 1, column] * (1 - x) + samples[row + 1, column + 1] * x) * y


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors (..., 3); for few of them much faster than numpy's."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _between(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows of values (N_s, k) at places between rings."""
    j = np.minimum(at.astype(int), len(values) - 2)
    t = (at - j)[:, None]
    return values[j] * (1 - t) + values[j + 1] * t


def _turned(arrow: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors (N_x, N_s, 3) turned by rotation vectors (N_s, 3) (Rodrigues)."""
    angle = _length(turn)
    axis = turn / np.maximum(angle, 1e-12)[:, None]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (arrow * axis).sum(axis=2, keepdims=True) * axis
    return along + c * (arrow - along) + s * cross(axis, arrow)
