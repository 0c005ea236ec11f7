"""Natural lengths and curvatures that a tube has as it is: what would make its present shape its natural one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .fields import Cut, bounds, pieces


def shape_now(
    tube: np.ndarray, spine: np.ndarray, cuts: Sequence[Cut] = (), spine_cuts: Sequence[Cut] = ()
) -> dict[str, np.ndarray]:
    """Natural shapes of a tube as `Material` takes them, in the units of its nodes.

    Args:
        tube: shape (N_x, N_s, 3).
        spine: shape (N_s, 3).
        cuts, spine_cuts: discontinuities.

    Returns:
        L1 (N_s - 1,), C2 (N_s,), L10, C20, C02 (N_x, N_s), L01, C11 (N_x, N_s - 1).
    """
    nx, ns, _ = tube.shape
    east, west = np.roll(tube, -1, axis=0), np.roll(tube, 1, axis=0)
    along = np.diff(tube, axis=1) * (ns - 1)
    first, last = bounds(ns, cuts)
    at = np.arange(ns)
    ds = tube[:, np.where(at < last, at + 1, at)] - tube[:, np.where(at > first, at - 1, at)]
    normal = _unit(np.cross(east - west, ds))
    around = (east - tube) * nx
    cell = _unit(np.cross(around[:, :-1] + around[:, 1:], along + np.roll(along, -1, axis=0)))
    bend = np.zeros_like(tube)
    bend[:, 1:-1] = np.diff(tube, 2, axis=1) * (ns - 1) ** 2
    return {
        "L1": np.linalg.norm(np.diff(spine, axis=0), axis=1) * (ns - 1),
        "C2": _turning(spine, spine_cuts),
        "L10": np.linalg.norm(around, axis=2),
        "L01": np.linalg.norm(along, axis=2),
        "C20": -np.sum(normal * (east - 2 * tube + west), axis=2) * nx**2,
        "C11": -np.sum(cell * np.diff(around, axis=1), axis=2) * (ns - 1),
        "C02": -np.sum(normal * bend, axis=2),
    }


def _turning(spine: np.ndarray, cuts: Sequence[Cut]) -> np.ndarray:
    """Curvature C2 in the plane of each piece, 0 at its ends, shape (N_s,)."""
    out = np.zeros(len(spine))
    for first, last in pieces(len(spine), cuts):
        own = spine[first : last + 1]
        turn = np.cross(_unit(own[2:] - own[:-2]), np.diff(own, 2, axis=0)) * (len(spine) - 1) ** 2
        out[first + 1 : last] = turn @ _unit(turn.sum(axis=0))
    return out


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
