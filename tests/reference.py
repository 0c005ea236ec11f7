"""Slow float64 references, sharing no code with the package: the paper's formulas written out plainly.

Tubes are (ns, nx, 3), ring after ring; spines (ns, 3). Material steps are 1 / nx around and 1 / (ns - 1) along.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np


def gradient(energy: Callable[[np.ndarray], float], v: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """Central differences of an energy by every entry of v; exact up to rounding where it is quadratic."""
    out = np.zeros(v.shape)
    for at in np.ndindex(*v.shape):
        ahead, behind = v.copy(), v.copy()
        ahead[at] += step
        behind[at] -= step
        out[at] = (energy(ahead) - energy(behind)) / (2 * step)
    return out


def spine_energy(v: np.ndarray, w1: np.ndarray, w2: np.ndarray) -> float:
    """(2) by differences; w1[k] belongs to the edge from k to k + 1, w2[k] to node k."""
    h = 1 / (len(v) - 1)
    energy = 0.0
    for k in range(len(v) - 1):
        energy += h * w1[k] * np.sum(((v[k + 1] - v[k]) / h) ** 2)
    for k in range(1, len(v) - 1):
        energy += h * w2[k] * np.sum(((v[k + 1] - 2 * v[k] + v[k - 1]) / h**2) ** 2)
    return energy


def bend_beyond_cubic(v: np.ndarray, w2: float) -> float:
    """The rigidity part of (2) of what a cubic in s leaves of the second difference."""
    h = 1 / (len(v) - 1)
    bend = np.diff(v, 2, axis=0) / h**2
    s = np.linspace(-1, 1, len(bend))
    rest = bend - np.stack([np.polyval(np.polyfit(s, b, 3), s) for b in bend.T], -1)
    return h * w2 * np.sum(rest**2)


def tube_energy(v: np.ndarray, **w: np.ndarray) -> float:
    """(3) by differences, periodic in x (6), rings at the ends with half a cell; weights w10 ... (ns, nx)."""
    ns, nx, _ = v.shape
    hx, hs = 1 / nx, 1 / (ns - 1)
    mass = end_mass(ns)[:, None]
    dx = (np.roll(v, -1, axis=1) - v) / hx
    dxx = (np.roll(v, -1, axis=1) - 2 * v + np.roll(v, 1, axis=1)) / hx**2
    ds = np.diff(v, axis=0) / hs
    dss = np.diff(v, 2, axis=0) / hs**2
    dxs = np.diff(dx, axis=0) / hs
    density = (
        np.sum(mass * w["w10"] * np.sum(dx**2, -1))
        + np.sum(mass * w["w20"] * np.sum(dxx**2, -1))
        + np.sum(w["w01"][:-1] * np.sum(ds**2, -1))
        + np.sum(w["w02"][1:-1] * np.sum(dss**2, -1))
        + np.sum(2 * w["w11"][:-1] * np.sum(dxs**2, -1))
    )
    return float(hx * hs * density)


def end_mass(ns: int) -> np.ndarray:
    """Share of a cell that belongs to each ring."""
    return np.array([0.5, *np.ones(ns - 2), 0.5])


def open_stiffness(tension: np.ndarray, rigidity: np.ndarray) -> np.ndarray:
    """Dense half Hessian, per h, of (2) on an open line."""
    n = len(tension)
    d1 = np.diff(np.eye(n), axis=0) * (n - 1)
    d2 = np.diff(np.eye(n), 2, axis=0) * (n - 1) ** 2
    return d1.T @ np.diag(tension[:-1]) @ d1 + d2.T @ np.diag(rigidity[1:-1]) @ d2


def ring_stiffness(tension: np.ndarray, rigidity: np.ndarray) -> np.ndarray:
    """Dense half Hessian, per h, of the x part of (3) on a ring."""
    n = len(tension)
    d1 = n * (np.roll(np.eye(n), 1, axis=1) - np.eye(n))
    d2 = n**2 * (np.roll(np.eye(n), 1, axis=1) - 2 * np.eye(n) + np.roll(np.eye(n), -1, axis=1))
    return d1.T @ np.diag(tension) @ d1 + d2.T @ np.diag(rigidity) @ d2


def ring_means(v: np.ndarray, spine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid (ns, 3) and mean radius (ns,) of each ring, the formulas below figure 7."""
    centroid, radius = np.zeros(spine.shape), np.zeros(len(spine))
    for s, ring in enumerate(v):
        ahead, behind = np.roll(ring, -1, axis=0) - ring, ring - np.roll(ring, 1, axis=0)
        weight = 0.5 * (np.linalg.norm(ahead, axis=1) + np.linalg.norm(behind, axis=1)) + 1e-15
        centroid[s] = weight @ ring / weight.sum()
        radius[s] = weight @ np.linalg.norm(ring - spine[s], axis=1) / weight.sum()
    return centroid, radius


def tangents(spine: np.ndarray, window: int, far: np.ndarray, shortest: float = 0.0) -> np.ndarray:
    """Sum of the spine's segments either side of each ring, the j-th away by its far^j, over its length.

    Where that is below `shortest` times 1 / (ns - 1) for each side that the ring has, over this instead.
    """
    segments = np.diff(spine, axis=0)
    out = np.zeros(spine.shape)
    for s in range(len(spine)):
        for j in range(window):
            if s + j < len(segments):
                out[s] += far[s] ** j * segments[s + j]
            if s - j > 0:
                out[s] += far[s] ** j * segments[s - j - 1]
    sides = np.array([1, *[2] * (len(spine) - 2), 1])[:, None]
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), shortest * sides / len(segments))


def project(matrix: np.ndarray, v: np.ndarray) -> np.ndarray:
    """World point (3,) to image point (2,)."""
    h = matrix @ [*v, 1.0]
    return h[:2] / h[2]


def slope(sizes: Sequence[int], errors: Sequence[float]) -> float:
    """Order of convergence: minus the slope of log error over log size, by regression."""
    return -float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
