"""The smooth surface through a tube's nodes: a mesh finer than the grid, its contour, its wires."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw
from scipy.interpolate import CubicSpline
from skimage import measure

from .camera import Camera
from .fields import Cut, pieces

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
    return smooth_pieces(tube, around, along)[0]


def smooth_pieces(
    tube: np.ndarray, around: int = AROUND, along: int | None = None, cuts: Sequence[Cut] = ()
) -> list[np.ndarray]:
    """The smooth surface as `smooth_grid` has it, parted at discontinuities, each piece of shape (around, n, 3)."""
    nx, ns, _ = tube.shape
    spectrum = np.fft.rfft(tube, axis=0)
    if nx % 2 == 0:
        spectrum[-1] *= 0.5
    rings = np.fft.irfft(spectrum, n=around, axis=0) * (around / nx)
    want = np.linspace(0, ns - 1, FINER * (ns - 1) + 1 if along is None else along)
    closed = is_closed(tube)
    if closed:
        rings[:, 0], rings[:, -1] = tube[:, 0].mean(0), tube[:, -1].mean(0)
    if not cuts:
        return [_spline(rings, want, closed, closed)]
    out = []
    for first, last in pieces(ns, cuts):
        inner = want[(want > first + 1e-6) & (want < last - 1e-6)]
        own = np.array([first, *inner, last]) - first
        out.append(_spline(rings[:, first : last + 1], own, closed and first == 0, closed and last == ns - 1))
    return out


def _spline(rings: np.ndarray, want: np.ndarray, first_closed: bool, last_closed: bool) -> np.ndarray:
    """Cubic along s at rows `want`, through an end that is a point to the opposite meridian."""
    ns, half = rings.shape[1], len(rings) // 2
    if not first_closed and not last_closed:
        return CubicSpline(np.arange(ns), rings, axis=1)(want)
    if first_closed and last_closed:
        loop = np.concatenate([rings[:half], rings[half:, -2::-1]], axis=1)
        spline = CubicSpline(np.arange(2 * ns - 1), loop, axis=1, bc_type="periodic")
        out = np.concatenate([spline(want), spline(2 * (ns - 1) - want)], axis=0)
    elif first_closed:
        line = np.concatenate([rings[half:, :0:-1], rings[:half]], axis=1)
        spline = CubicSpline(np.arange(1 - ns, ns), line, axis=1)
        out = np.concatenate([spline(want), spline(-want)], axis=0)
    else:
        return _spline(rings[:, ::-1], ns - 1 - want[::-1], True, False)[:, ::-1]
    for end, closed in ((0, first_closed), (-1, last_closed)):
        if closed:
            out[:, end] = rings[0, end]
    return out


def bodies(tube: np.ndarray, around: int, along: int | None, cuts: Sequence[Cut]) -> list[tuple[np.ndarray, bool, bool]]:
    """The smooth surface parted at gaps alone: its grid, and whether the first and the last end is a point."""
    out: list[tuple[np.ndarray, bool, bool]] = []
    closed, ends = is_closed(tube), pieces(tube.shape[1], cuts)
    for grid, (first, last) in zip(smooth_pieces(tube, around, along, cuts), ends, strict=True):
        shut = closed and last == tube.shape[1] - 1
        if first > 0 and (first, False) in cuts:
            before, start, _ = out.pop()
            out.append((np.concatenate([before, grid[:, 1:]], axis=1), start, shut))
        else:
            out.append((grid, closed and first == 0, shut))
    return out


def refine(
    tube: np.ndarray, around: int = AROUND, along: int | None = None, cuts: Sequence[Cut] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Watertight mesh of the smooth surface, outward normals, seam welded, one vertex at each end.

    An open end is closed by a fan to the middle of its ring, and so are both sides of a gap.

    Args:
        tube: shape (N_x, N_s, 3).
        around: vertices around, even.
        along: rows from end to end.
        cuts: discontinuities, see `fields.cuts`.

    Returns:
        vertices (V, 3), faces (F, 3).
    """
    vertices, faces, count = [], [], 0
    for grid, start, end in bodies(tube, around, along, cuts):
        body = grid[:, int(start) : grid.shape[1] - int(end)]
        n, m = body.shape[:2]
        ends = grid[:, [0, -1]].mean(axis=0)
        vertices.append(np.concatenate([body.transpose(1, 0, 2).reshape(-1, 3), ends]))
        x = np.arange(n)
        y = (x + 1) % n
        rows = n * np.arange(m - 1)[:, None]
        a, b, c, d = rows + x, rows + y, rows + n + y, rows + n + x
        quads = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
        first, last = n * m, n * m + 1
        top = n * (m - 1)
        caps = np.concatenate([np.stack([np.full(n, first), y, x], -1), np.stack([np.full(n, last), top + x, top + y], -1)])
        faces.append(np.concatenate([quads, caps]).astype(np.int64) + count)
        count += len(vertices[-1])
    return np.concatenate(vertices), np.concatenate(faces)


def volume_and_area(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, float]:
    """Volume within and area of a closed mesh."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    return float(np.einsum("ij,ij->", a, n) / 6), float(np.linalg.norm(n, axis=1).sum() / 2)


def occluding_contour(tube: np.ndarray, camera: Camera, cuts: Sequence[Cut] = ()) -> list[tuple[np.ndarray, np.ndarray]]:
    """The contour i.n = 0 of the smooth surface (12) in a view, not beyond discontinuities.

    Returns:
        For each connected piece: image points (n, 2) and outward unit normals (n, 2) in the image.
    """
    found, closed, ns = [], is_closed(tube), tube.shape[1]
    for grid, (first, last) in zip(smooth_pieces(tube, cuts=cuts), pieces(ns, cuts), strict=True):
        dx = np.roll(grid, -1, axis=0) - np.roll(grid, 1, axis=0)
        ds = np.gradient(grid, axis=1)
        normal = np.cross(dx, ds)
        if closed and first == 0:
            normal[:, 0] = -np.mean(ds[:, 1], axis=0)
        if closed and last == ns - 1:
            normal[:, -1] = np.mean(ds[:, -2], axis=0)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        facing = np.sum(camera.sight(grid) * normal, axis=-1)
        wrapped = np.concatenate([facing, facing[:1]])
        for line in measure.find_contours(wrapped, 0.0):
            points = camera.project(_at(grid, line))
            length = np.linalg.norm(grid[0, -1] - grid[0, 0])
            ahead = camera.project(_at(grid, line) + 1e-4 * length * _at(normal, line))
            step = ahead - points
            found.append((points, step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-30)))
    return found


def _at(values: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Bilinear values at (around, along) positions, periodic around."""
    n, m = values.shape[:2]
    i = np.floor(line[:, 0]).astype(int)
    j = np.minimum(np.floor(line[:, 1]).astype(int), m - 2)
    u, v = (line[:, 0] - i)[:, None], (line[:, 1] - j)[:, None]
    i, k = i % n, (i + 1) % n
    low = (1 - u) * values[i, j] + u * values[k, j]
    return (1 - v) * low + v * ((1 - u) * values[i, j + 1] + u * values[k, j + 1])


def wire(tube: np.ndarray, around: int = 16, along: int = 25, cuts: Sequence[Cut] = ()) -> list[np.ndarray]:
    """Rings and meridians on the smooth surface, polylines (n, 3); about `along` rings, those at gaps among them."""
    lines, grids = [], [grid for grid, _, _ in bodies(tube, AROUND, None, cuts)]
    whole = sum(grid.shape[1] for grid in grids)
    for grid in grids:
        n, m = grid.shape[:2]
        rows = np.unique(np.linspace(0, m - 1, max(2, round(along * m / whole))).astype(int))
        lines += [np.concatenate([grid[:, j], grid[:1, j]]) for j in rows]
        lines += [grid[i] for i in np.unique(np.linspace(0, n, around, endpoint=False).astype(int))]
    return lines


def silhouette(points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Samples (h, w), bool, that the patches of a projected grid, shape (N_x, N_s, 2), cover."""
    picture = Image.new("1", (shape[1], shape[0]))
    draw = ImageDraw.Draw(picture)
    around = np.roll(points, -1, axis=0)
    patches = np.stack([points[:, :-1], points[:, 1:], around[:, 1:], around[:, :-1]], axis=2).reshape(-1, 8)
    if np.ptp(points[:, [0, -1]], axis=0).max() < 1e-3:  # shut: whatever one side covers, the other does
        x, y = (patches[:, i] - patches[:, i + 4] for i in (0, 1))
        u, v = (patches[:, i + 2] - patches[:, (i + 6) % 8] for i in (0, 1))
        patches = patches[x * v - y * u >= 0]
    for corners in patches.tolist():
        draw.draw.draw_polygon(corners, 1, 1)  # as `draw.polygon` does, which spends most of its time on what a colour is
    return np.asarray(picture)
