"""Rigid first, then deformable (section 4.3): a few moves of the whole tube, as a rigid body or as a rod that bends.

Each ring moves rigidly, by c + w x (p - spine), with c and w polynomials along the spine; of degree 0 the tube as a whole.
What the contours of all views are off by, least squares make up for (Gauss and Newton).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
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
    place = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(spine, axis=0), axis=1)))
    length = place[-1]
    if not length > 0:
        return tube, spine
    u = 2 * place / length - 1
    basis = np.polynomial.legendre.legvander(u, degree)
    rows, off = [], []
    for camera, potential, size, hides in zip(cameras, potentials, sizes, hidden or [None] * len(cameras), strict=True):
        at, points, normal, share = contour(tube, camera, size, closed, hides)
        if len(at):
            pixels, slope = linearised(camera, points)
            m = np.einsum("nij,nj->ni", slope, normal)
            m /= np.maximum(np.linalg.norm(m, axis=1, keepdims=True), 1e-12)
            value = look_up(potential, pixels)
            lever = points - _between(spine, at)
            along = np.einsum("ni,nij->nj", m, slope)
            own = np.concatenate([along, np.cross(lever, along)], axis=1)
            rows.append(share[:, None] * (_between(basis, at)[:, :, None] * own[:, None]).reshape(len(at), -1))
            off.append(share * ((value[:, :2] * m).sum(axis=1) + value[:, 2]))
    if not rows:
        return tube, spine
    a, d = np.concatenate(rows), np.concatenate(off)
    scale = np.sqrt((a[:, :3] ** 2).sum() / 3)  # pixels for a unit of length
    # w in radians, c in lengths: as far as both move a ring's contour about as much
    if degree > 0:
        slope = np.stack([np.polynomial.legendre.legval(u, np.polynomial.legendre.legder(c)) for c in np.eye(degree + 1)], 1)
        tangent = np.gradient(spine, u, axis=0)
        turn = np.stack([np.cross(e, tangent) for e in np.eye(3)], axis=2)
        free = np.concatenate(
            [slope[:, None, :, None] * np.eye(3)[None, :, None], -basis[:, None, :, None] * turn[:, :, None]], axis=3
        )
        weight = ROD * scale / np.sqrt(len(u))
        spin = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-30)
        spin *= TWIST * np.linalg.norm(tube - spine, axis=2).mean(axis=0)[:, None]
        about = basis[:, :, None, None] * np.stack([np.zeros_like(spin), spin], axis=1)[:, None]
        a = np.concatenate([a, weight * free.reshape(-1, a.shape[1]), weight * about.reshape(-1, a.shape[1])])
        d = np.append(d, np.zeros(len(a) - len(d)))
    grow = np.repeat((1.0 + np.arange(degree + 1)) ** 2, 6)
    size = np.tile(np.repeat([1.0, 0.5 * length], 3), degree + 1)
    matrix = a.T @ a + STEADY * scale**2 * np.diag(grow * size**2)
    x = np.linalg.solve(matrix, a.T @ d).reshape(degree + 1, 6)
    step, turn = basis @ x[:, :3], basis @ x[:, 3:]
    moved = spine + step
    return moved[None] + _turned(tube - spine, turn), moved


def contour(
    tube: np.ndarray, camera: Camera, size: tuple[int, ...], closed: bool, hidden: Hidden | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the occluding contour i.n = 0 crosses the grid's lines within an image of a size (height, width), not hidden.

    Returns:
        place along s [rings] (n,), point (n, 3), normal (n, 3), root of the share of the contour that it stands for (n,).
    """
    around, along = np.roll(tube, -1, axis=0) - np.roll(tube, 1, axis=0), np.gradient(tube, axis=1)
    normal = np.cross(around, along)
    if closed:
        normal[:, 0], normal[:, -1] = -along[:, 0].mean(axis=0), along[:, -1].mean(axis=0)
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-30)
    facing = (camera.sight(tube) * normal).sum(axis=2)
    flat = camera.project(tube)
    found = []
    for axis in (0, 1):
        a, b = (facing, np.roll(facing, -1, axis=0)) if axis == 0 else (facing[:, :-1], facing[:, 1:])
        i, j = np.nonzero((a >= 0) != (b >= 0))
        keep = (j > 0) & (j < tube.shape[1] - 1) if axis == 0 and closed else np.ones(len(i), bool)
        i, j = i[keep], j[keep]
        t = a[i, j] / (a[i, j] - b[i, j])
        i2, j2 = ((i + 1) % len(tube), j) if axis == 0 else (i, j + 1)
        point = tube[i, j] + t[:, None] * (tube[i2, j2] - tube[i, j])
        n = normal[i, j] + t[:, None] * (normal[i2, j2] - normal[i, j])
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30)
        # the length across the line that it crosses
        if axis == 0:
            ends = flat[i, np.minimum(j + 1, tube.shape[1] - 1)], flat[i, np.maximum(j - 1, 0)]
        else:
            ends = flat[(i + 1) % len(tube), j], flat[i - 1, j]
        long = 0.5 * np.linalg.norm(ends[0] - ends[1], axis=1)
        found.append((j + t * axis, point, n, long))
    at, point, n, long = (np.concatenate(parts) for parts in zip(*found, strict=True))
    pixels = camera.project(point)
    within = ((pixels >= 0) & (pixels <= np.array(size[1::-1]) - 1)).all(axis=1)
    if hidden is not None:
        within &= ~hidden.at(pixels)
    at, point, n, long = at[within], point[within], n[within], long[within]
    return at, point, n, np.sqrt(long / max(long.sum(), 1e-30))


def linearised(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image points (n, 2) of world points (n, 3), and their derivative (n, 2, 3)."""
    m = camera.matrix
    flat = camera.project(points)
    depth = points @ m[2, :3] + m[2, 3]
    return flat, (m[None, :2, :3] - flat[..., None] * m[2, :3]) / depth[:, None, None]


def look_up(potential: Potential, points: np.ndarray) -> np.ndarray:
    """Samples at image points (n, 2), bilinear, the border's beyond it; shape (n, 4)."""
    at = (points - np.array(potential.origin)) / potential.step
    return np.stack(
        [
            ndimage.map_coordinates(potential.samples[..., c], at.T[::-1], order=1, mode="nearest")
            for c in range(potential.samples.shape[2])
        ],
        axis=1,
    )


def _between(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows of values (N_s, k) at places between rings."""
    j = np.minimum(at.astype(int), len(values) - 2)
    t = (at - j)[:, None]
    return values[j] * (1 - t) + values[j + 1] * t


def _turned(arrow: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors (N_x, N_s, 3) turned by rotation vectors (N_s, 3) (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=1)
    axis = turn / np.maximum(angle, 1e-12)[:, None]
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (arrow * axis).sum(axis=2, keepdims=True) * axis
    return along + c * (arrow - along) + s * np.cross(axis, arrow)
