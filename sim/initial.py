"""The first tube: circles round a rough axis, closed at both ends; and how rings are dealt out anew later on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline

from .camera import Camera
from .fields import Cut, pieces
from .foreground import axis_curve
from .surface import smooth_grid, smooth_pieces

GATHER = 0.3
"""How much closer the rings of a closed tube stand at its ends than evenly: caps need them more than the body."""

TURNING = 0.2
"""Share of the rings dealt out by how much the meridians turn; the others by their length."""
TURNING_OFF = 3
"""Rings beside a discontinuity whose turning does not count."""
FINE = 20
"""Points of a meridian between two rings, for dealing them anew."""

STEADY = 0.5
"""How far along the spine a ring's tangent looks, in radii of the tube there: about as far as a cap can roll."""
SPREAD = 5
"""Segments of the spine over which their length is averaged for that."""


def lift(points: np.ndarray, camera: Camera, depth: float) -> np.ndarray:
    """World points of image points at a depth along the view's axis.

    Args:
        points: shape (n, 2), image points (column, row).
        camera: of the view.
        depth: along the axis from the world's origin (affine), or from the focal point (perspective) [world units].

    Returns:
        shape (n, 3).

    Raises:
        ValueError: depth is not positive in a perspective view.
    """
    m = camera.matrix
    if camera.affine:
        flat = (points - m[:2, 3]) @ np.linalg.pinv(m[:2, :3]).T
        return flat + depth * camera.sight(np.zeros(3))
    if depth <= 0:
        raise ValueError("a perspective view needs a spine in world points, or a positive depth")
    h = np.column_stack([points, np.ones(len(points))]) * depth
    return (h - m[:, 3]) @ np.linalg.inv(m[:, :3]).T


def frames(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangent, normal and binormal along a curve without twist (double reflection), shape (n, 3) each, N x B = T."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    first = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    normal = np.zeros_like(curve)
    normal[0] = first - tangent[0] * (first @ tangent[0])
    normal[0] /= np.linalg.norm(normal[0])
    for i in range(len(curve) - 1):
        v = curve[i + 1] - curve[i]
        n = normal[i] - 2 * v * (v @ normal[i]) / (v @ v)
        t = tangent[i] - 2 * v * (v @ tangent[i]) / (v @ v)
        u = tangent[i + 1] - t
        uu = u @ u
        normal[i + 1] = n - (2 * u * (u @ n) / uu if uu > 1e-14 else 0.0)
    return tangent, normal, np.cross(tangent, normal)


def initial_tube(
    axis: np.ndarray, radius: float, grid: tuple[int, int], closed: bool, marks: Sequence[tuple[float, float]] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Tube and spine: circles of one radius, round ends when closed.

    Args:
        axis: rough axis in the world, shape (n, 3).
        radius: [world units].
        grid: nodes around, nodes along.
        closed: ends shut to a point.
        marks: (ring, between two where it is no whole number; share of the axis' length where it must stand).

    Returns:
        tube (N_x, N_s, 3), spine (N_s, 3).
    """
    nx, ns = grid
    s = np.linspace(0, 1, ns)
    fine = axis_curve(axis, 40 * ns)
    place = s - GATHER * np.sin(2 * np.pi * s) / (2 * np.pi) if closed else s
    if marks:
        rings, shares = np.array(sorted(marks), float).T
        place = np.interp(place, [0, *np.interp(rings, np.arange(ns), place), 1], [0, *shares, 1])
    spine = np.stack([np.interp(place, np.linspace(0, 1, 40 * ns), fine[:, i]) for i in range(3)], axis=1)
    _, normal, binormal = frames(spine)
    angle = 2 * np.pi * np.arange(nx) / nx
    circle = np.cos(angle)[:, None, None] * normal + np.sin(angle)[:, None, None] * binormal
    r = np.full(ns, radius)
    if closed:
        length = np.linalg.norm(np.diff(axis, axis=0), axis=1).sum()
        reach = length * np.minimum(place, 1 - place)
        cap = min(radius, 0.25 * length)
        r = radius * np.sqrt(np.clip(1 - np.clip(1 - reach / cap, 0, 1) ** 2, 0, 1))
        r[[0, -1]] = 0.0
    return spine + r[:, None] * circle, spine


def deal(tube: np.ndarray, spine: np.ndarray, cuts: Sequence[Cut] = ()) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with its rings dealt out anew: close where the meridians turn, as at a rim, even elsewhere.

    Each piece between discontinuities keeps its rings.

    Args:
        tube: shape (N_x, N_s, 3).
        spine: shape (N_s, 3).
        cuts: discontinuities of tube or spine.

    Returns:
        tube, spine of the same shapes.
    """
    nx, ns, _ = tube.shape
    if not cuts:
        return _dealt(tube, spine, smooth_grid(tube, 2 * nx, FINE * (ns - 1) + 1)[::2])
    tube, spine = tube.copy(), spine.copy()
    surfaces = smooth_pieces(tube, 2 * nx, FINE * (ns - 1) + 1, cuts)
    for surface, (first, last) in zip(surfaces, pieces(ns, cuts), strict=True):
        own = slice(first, last + 1)
        tube[:, own], spine[own] = _dealt(tube[:, own], spine[own], surface[::2], first > 0, last < ns - 1)
    return tube, spine


def _dealt(
    tube: np.ndarray, spine: np.ndarray, surface: np.ndarray, cut_first: bool = False, cut_last: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """One piece dealt out anew on its surface of `FINE` columns a gap, shape (N_x, n, 3).

    What turns beside a cut is the cut's doing, whose own ring lies in it: it needs no others close by.
    """
    ns, fine = tube.shape[1], surface.shape[1]
    step = np.diff(surface, axis=1)
    length = np.linalg.norm(step, axis=2)
    along = step / np.maximum(length, 1e-12)[..., None]
    turn = np.linalg.norm(np.diff(along, axis=1), axis=2).mean(axis=0)
    turn = 0.5 * (np.append(turn, 0.0) + np.append(0.0, turn))
    beside = TURNING_OFF * FINE
    turn[: beside * cut_first] = 0.0
    turn[len(turn) - beside * cut_last :] = 0.0
    length = length.mean(axis=0)
    share = (1 - TURNING) * length / length.sum() + TURNING * turn / max(turn.sum(), 1e-6)
    place = np.interp(np.linspace(0, 1, ns), np.append(0.0, np.cumsum(share / share.sum())), np.linspace(0, ns - 1, fine))
    place[[0, -1]] = 0, ns - 1
    rings = _columns(surface, place * (fine - 1) / (ns - 1))
    rings[:, [0, -1]] = tube[:, [0, -1]]
    return rings, CubicSpline(np.arange(ns), spine)(place)


def _columns(surface: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Columns of a finely sampled surface (N_x, n, 3) at places between them, cubic by the four about each (Lagrange)."""
    first = np.clip(np.floor(at).astype(int) - 1, 0, surface.shape[1] - 4)
    t = at - first
    weights = [t * 0 + 1.0 for _ in range(4)]
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[i] = weights[i] * (t - j) / (i - j)
    return sum((w[:, None] * surface[:, first + i] for i, w in enumerate(weights)), np.zeros(()))


def fading(tube: np.ndarray, spine: np.ndarray) -> np.ndarray:
    """Importance for each ring's tangent of a segment of the spine over that of the one before, shape (N_s,).

    It falls to 1 / e over `STEADY` radii of the widest ring that reaches so far: at a round end the rings could as
    well lie round any other pole, and what tells is the axis of the body behind.
    """
    radius = np.linalg.norm(tube - spine, axis=2).mean(axis=0)
    step = np.linalg.norm(np.diff(spine, axis=0), axis=1)
    place = np.append(0.0, np.cumsum(step))
    reaches = np.abs(place[:, None] - place) <= radius
    widest = np.where(reaches, radius, 0.0).max(axis=1)
    step = ndimage.uniform_filter1d(np.append(step, step[-1]), SPREAD, mode="nearest")
    return np.exp(-step / (STEADY * np.maximum(widest, 1e-9)))
