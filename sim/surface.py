"""The smooth surface through a tube's nodes: a mesh finer than the grid, its contour, its wires."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from skimage import measure

from .camera import Camera

AROUND, FINER = 96, 5
"""Vertices around, and rows for each gap of the grid, of the surface that is measured and written."""


def is_closed(tube: np.ndarray) -> bool:
    """Whether the end rings are single points."""
    size = np.linalg.norm(np.ptp(tube.reshape(-1, 3), axis=0))
    return bool(np.ptp(tube[:, [0, -1]], axis=0).max() < 1e-5 * size)


def smooth_grid(tube: np.ndarray, around: int = AROUND, along: int | None = None) -> np.ndarray:
    """Points of the smooth surface: trigonometric around, cubic along; through a closed end to the opposite meridian.

    Args:
        tube: shape (N_x, N_s, 3).
        around: points around, even.
        along: points along; None: `FINER` for each gap.

    Returns:
        shape (around, along, 3); first and last column are the ends.
    """
    nx, ns, _ = tube.shape
    spectrum = np.fft.rfft(tube, axis=0)
    if nx % 2 == 0:
        spectrum[-1] *= 0.5
    rings = np.fft.irfft(spectrum, n=around, axis=0) * (around / nx)
    want = np.linspace(0, ns - 1, FINER * (ns - 1) + 1 if along is None else along)
    if not is_closed(tube):
        return CubicSpline(np.arange(ns), rings, axis=1)(want)
    half = around // 2
    rings[:, 0], rings[:, -1] = tube[:, 0].mean(0), tube[:, -1].mean(0)
    loop = np.concatenate([rings[:half], rings[half:, -2::-1]], axis=1)
    spline = CubicSpline(np.arange(2 * ns - 1), loop, axis=1, bc_type="periodic")
    out = np.concatenate([spline(want), spline(2 * (ns - 1) - want)], axis=0)
    out[:, 0], out[:, -1] = rings[0, 0], rings[0, -1]
    return out


def refine(tube: np.ndarray, around: int = AROUND, along: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Watertight mesh of the smooth surface, outward normals, seam welded, one vertex at each end.

    An open end is closed by a fan to the middle of its ring.

    Args:
        tube: shape (N_x, N_s, 3).
        around: vertices around, even.
        along: rows from end to end.

    Returns:
        vertices (V, 3), faces (F, 3).
    """
    grid = smooth_grid(tube, around, along)
    body = grid[:, 1:-1] if is_closed(tube) else grid
    n, m = body.shape[:2]
    ends = grid[:, [0, -1]].mean(axis=0)
    vertices = np.concatenate([body.transpose(1, 0, 2).reshape(-1, 3), ends])
    x = np.arange(n)
    y = (x + 1) % n
    rows = n * np.arange(m - 1)[:, None]
    a, b, c, d = rows + x, rows + y, rows + n + y, rows + n + x
    quads = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    first, last = n * m, n * m + 1
    top = n * (m - 1)
    caps = np.concatenate([np.stack([np.full(n, first), y, x], -1), np.stack([np.full(n, last), top + x, top + y], -1)])
    return vertices, np.concatenate([quads, caps]).astype(np.int64)


def volume_and_area(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
    """Volume within and area of a closed mesh."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    return float(np.einsum("ij,ij->", a, n) / 6), float(np.linalg.norm(n, axis=1).sum() / 2)


def occluding_contour(tube: np.ndarray, camera: Camera) -> list[tuple[np.ndarray, np.ndarray]]:
    """The contour i.n = 0 of the smooth surface (12) in a view.

    Returns:
        For each connected piece: image points (n, 2) and outward unit normals (n, 2) in the image.
    """
    grid = smooth_grid(tube)
    closed = is_closed(tube)
    dx = np.roll(grid, -1, axis=0) - np.roll(grid, 1, axis=0)
    ds = np.gradient(grid, axis=1)
    normal = np.cross(dx, ds)
    if closed:
        normal[:, 0] = -np.mean(ds[:, 1], axis=0)
        normal[:, -1] = np.mean(ds[:, -2], axis=0)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    facing = np.sum(camera.sight(grid) * normal, axis=-1)
    wrapped = np.concatenate([facing, facing[:1]])
    pieces = []
    for line in measure.find_contours(wrapped, 0.0):
        points = camera.project(_at(grid, line))
        length = np.linalg.norm(grid[0, -1] - grid[0, 0])
        ahead = camera.project(_at(grid, line) + 1e-4 * length * _at(normal, line))
        step = ahead - points
        pieces.append((points, step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-30)))
    return pieces


def _at(values: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Bilinear values at (around, along) positions, periodic around."""
    n, m = values.shape[:2]
    i = np.floor(line[:, 0]).astype(int)
    j = np.minimum(np.floor(line[:, 1]).astype(int), m - 2)
    u, v = (line[:, 0] - i)[:, None], (line[:, 1] - j)[:, None]
    i, k = i % n, (i + 1) % n
    low = (1 - u) * values[i, j] + u * values[k, j]
    return (1 - v) * low + v * ((1 - u) * values[i, j + 1] + u * values[k, j + 1])


def wire(tube: np.ndarray, around: int = 16, along: int = 25) -> list[np.ndarray]:
    """Rings and meridians on the smooth surface, polylines of shape (n, 3)."""
    grid = smooth_grid(tube)
    n, m = grid.shape[:2]
    rings = [np.concatenate([grid[:, j], grid[:1, j]]) for j in np.unique(np.linspace(0, m - 1, along).astype(int))]
    return rings + [grid[i] for i in np.unique(np.linspace(0, n, around, endpoint=False).astype(int))]
