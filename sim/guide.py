"""How an axis goes on where views tell its depth badly: as its better told parts do (ours)."""

from __future__ import annotations

import numpy as np

NARROW = 4.0
"""How much more than the weakest the next direction must be told for eyes to count as all but one; else in proportion."""
MODES = 12
"""Of the course."""
SMOOTH, CLOSELY = 1.0, 0.7
"""Length over which the course is smoothed, in radii of the tube: of a still scene, whose ends may begin anywhere; and while
following, when they begin where they belong and are only to be kept there, and a joint in the body must not turn them."""
LEAST = 0.1
"""Say of an end in the course, over that of a ring of the body."""


def weakest(value: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The direction that views tell least, as long as the root of how much it needs a guide, 0 to 1.

    Args:
        value: stiffness of all views together along three axes, rising, shape (n, 3).
        axes: those axes, columns, shape (n, 3, 3).

    Returns:
        shape (n, 3).
    """
    share = np.clip(1 - NARROW * value[:, 0] / np.maximum(value[:, 1], 1e-12), 0.0, 1.0)
    return axes[:, :, 0] * np.sqrt(share)[:, None]


def ends(spine: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """How far a ring lies from the nearer closed end, over the widest radius that reaches there, at most 1, shape (n,).

    Outlines place the surface of a round end, but not the axis in it, which could as well lead to any other pole; those
    of a flat end show nothing of it where it leans towards the viewer or away.

    Args:
        spine: shape (n, 3).
        radius: of the rings, shape (n,).
    """
    place = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(spine, axis=0), axis=1)))
    reaches = np.abs(place[:, None] - place) <= radius
    widest = np.maximum(np.where(reaches, radius, 0.0).max(axis=1), 1e-9)
    return np.clip(np.minimum(place, place[-1] - place) / widest, 0.0, 1.0)


def course(spine: np.ndarray, radius: np.ndarray, say: np.ndarray, smooth: float = SMOOTH) -> tuple[np.ndarray, np.ndarray]:
    """A smoother of curves along a spine: it leaves even bends as they are, and has ends go on as the body does.

    It minimises the sum of say |v - u|^2 + l^6 |u'''|^2 over u; l is `smooth` radii. Of its modes the stiffest are left
    out, as it all but does itself.

    Args:
        spine: shape (n, 3).
        radius: of the rings, shape (n,).
        say: weight of each ring, shape (n,), above 0.
        smooth: see `SMOOTH`.

    Returns:
        modes (n, MODES) and weights (n,), so that u = modes @ modes.T @ (weights v).
    """
    n = len(spine)
    step = np.linalg.norm(np.diff(spine, axis=0), axis=1)
    place = np.append(0.0, np.cumsum(np.maximum(step, 1e-3 * step.mean())))
    length, place = place[-1], place / place[-1]
    third, at = np.eye(n), place
    for _ in range(3):
        third = np.diff(third, axis=0) / np.diff(at)[:, None]
        at = (at[1:] + at[:-1]) / 2
    weight = say * np.gradient(place)
    root = 1 / np.sqrt(weight)
    value, mode = np.linalg.eigh(root[:, None] * (third.T @ (np.gradient(at)[:, None] * third)) * root)
    far = smooth * np.median(radius) / length
    kept = min(n, MODES)
    modes = np.zeros((n, MODES))
    modes[:, :kept] = (root[:, None] * mode / np.sqrt(1 + far**6 * np.maximum(value, 0.0)))[:, :kept]
    return modes, weight
