"""Ends at which an object goes on beyond its tube, as a finger does into a hand: what lies past them is not looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from .foreground import axis_curve
from .hidden import window

NAMES = {"no": (False, False), "first": (True, False), "last": (False, True), "both": (True, True)}
"""Words for the ends, in order along the axis."""
ANCHOR = 5
"""Least rings before an end that say which way it goes on, and how wide; as many as reach over the tube's width, if more."""
BACK = 0.25
"""Share of a curve behind its end that says which way it goes on."""


def past(curve: np.ndarray, ends: Sequence[bool], shape: tuple[int, ...], box: np.ndarray | None = None) -> np.ndarray:
    """Pixels (H, W), bool, ahead of the ends of a curve, to which no other of its points is nearer.

    Args:
        curve: shape (n, 2), image points.
        ends: which of the first and the last.
        shape: of the image.
        box: least and greatest image point, shape (2, 2), of what is asked for; None: the whole image.
    """
    out = np.zeros(shape[:2], bool)
    rows, columns = window(np.array([[0, 0], shape[1::-1]]) if box is None else box, shape)
    line = axis_curve(curve)
    tree, inner = KDTree(line), int(BACK * len(line))
    y, x = np.mgrid[rows, columns]
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    for end, back in ((0, inner), (-1, -1 - inner)):
        if ends[end]:
            ahead = np.flatnonzero((points - line[end]) @ (line[end] - line[back]) > 0)
            nearest = tree.query(points[ahead])[1]
            at = points[ahead[nearest == end % len(line)]]
            out[at[:, 1], at[:, 0]] = True
    return out


def unseen(ignore: np.ndarray | None, curve: np.ndarray, ends: Sequence[bool], shape: tuple[int, ...]) -> np.ndarray | None:
    """What is not to be looked at in an image, shape (H, W), for an object with a curve (n, 2) for its axis."""
    if not any(ends):
        return ignore
    mask = past(curve, ends, shape)
    return mask if ignore is None else mask | ignore


def places(spine: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Where along a spine (N_s, d) the points nearest to its two ends as drawn, shape (2, d), lie [rings], shape (2,)."""
    fine = np.linspace(0, len(spine) - 1, 20 * len(spine))
    line = between(spine, fine)
    return fine[((line[None] - ends[:, None]) ** 2).sum(axis=2).argmin(axis=1)]


def between(spine: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Points of a spine (N_s, d) at places along it [rings]."""
    return np.stack([np.interp(at, np.arange(len(spine)), column) for column in spine.T], axis=1)


def part(spine: np.ndarray, at: np.ndarray, count: int = 60) -> np.ndarray:
    """The part of a spine (N_s, d) between two places along it [rings], shape (count, d)."""
    return between(spine, np.linspace(at[0], at[1], count))


def capped(tube: np.ndarray, spine: np.ndarray, ends: Sequence[bool], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A tube (N_x, N_s, 3) and its spine with round caps, as deep as wide, past ends: nothing is known of what is there.

    Args:
        tube, spine: shape (N_x, N_s, 3), (N_s, 3).
        ends: at which the object goes on.
        at: where along the spine they lie [rings], shape (2,).

    Returns:
        tube, spine.
    """
    tube, spine = tube.copy(), spine.copy()
    count, inner = len(spine), np.clip(at, 1, len(spine) - 2)
    for end, last, outward in ((0, int(np.ceil(inner[0])), -1), (1, int(np.floor(inner[1])), 1)):
        if not ends[end]:
            continue
        radius = np.linalg.norm(tube[:, last] - spine[last], axis=1).mean()
        far = np.flatnonzero(np.linalg.norm(spine - spine[last], axis=1) < 2 * radius)
        reach = int(max(ANCHOR, np.max(outward * (last - far), initial=0)))
        # rings beside the end are pulled aside by what it goes on into: a line through many, not the last one's word
        anchor = np.clip(last - outward * np.arange(reach + 1), 0, count - 1)
        middle = spine[anchor].mean(axis=0)
        ahead = np.linalg.svd(spine[anchor] - middle, full_matrices=False)[2][0]
        ahead *= np.sign(ahead @ (spine[last] - spine[anchor[-1]])) or 1.0
        ring = (tube[:, anchor] - spine[anchor]).mean(axis=1)
        radius = np.linalg.norm(ring, axis=1).mean()
        past_ = np.arange(last + outward, count if end else -1, outward)
        share = np.sin(0.5 * np.pi * np.abs(past_ - last) / len(past_))
        start = middle + ((spine[last] - middle) @ ahead) * ahead
        spine[past_] = start + radius * share[:, None] * ahead
        tube[:, past_] = spine[past_] + np.sqrt(1 - np.minimum(share, 1.0) ** 2)[:, None] * ring[:, None]
        tube[:, past_[-1]] = spine[past_[-1]]
    return tube, spine
