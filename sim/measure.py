"""What a finished tube measures, and how far the image supports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline

from .camera import Camera
from .fields import Cut, pieces
from .foreground import Foreground
from .hidden import Hidden
from .potential import Potential
from .surface import refine, silhouette, smooth_pieces, volume_and_area

REACH = 0.15
"""How far from the contour its edge is looked for, in half widths of the object."""
RINGING = 12
"""Samples beyond which no other matters to a cubic spline."""
STRONG = 0.2
"""Least strength of an edge, beside the contour's typical one."""
SURE = 0.9
"""Of the map: surely the object above, surely not below 1 - SURE."""


def arc_length(spine: np.ndarray, cuts: Sequence[Cut] = ()) -> np.ndarray:
    """Arc length of a curve through nodes, smooth but for its discontinuities, from the first to each, shape (N_s,).

    What a gap is wide does not count.
    """
    if cuts:
        arc = np.zeros(len(spine))
        for first, last in pieces(len(spine), cuts):
            own = arc_length(spine[first : last + 1])
            arc[first : last + 1] = own + (arc[first] if (first, False) in cuts else arc[max(first - 1, 0)])
        return arc
    chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(spine, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(chord) > 1e-9 * chord[-1]])
    spline = CubicSpline(chord[keep], spine[keep])
    fine = np.linspace(0, chord[-1], 40 * len(spine))
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(spline(fine), axis=0), axis=1))])
    return np.interp(chord, fine, arc)


def shape_measures(
    tube: np.ndarray, spine: np.ndarray, cuts: Sequence[Cut] = (), spine_cuts: Sequence[Cut] = ()
) -> dict[str, Any]:
    """Length, radius profile, volume, area [world units] and asymmetry of a tube.

    Args:
        tube: shape (N_x, N_s, 3).
        spine: shape (N_s, 3).
        cuts, spine_cuts: discontinuities of tube and spine.

    Returns:
        length along the spine; station and radius, lists with an entry a ring (mean |r| as below fig. 7);
        volume; area; asymmetry: root mean square of |r| / rbar - 1 over the rings, weighted by their radius.
    """
    station = arc_length(spine, spine_cuts)
    r = np.linalg.norm(tube - spine, axis=2)
    step = np.linalg.norm(np.roll(tube, -1, axis=0) - np.roll(tube, 1, axis=0), axis=2)
    weight = step / np.maximum(step.sum(axis=0), 1e-30)
    radius = np.where(step.sum(axis=0) > 0, (r * weight).sum(axis=0), r.mean(axis=0))
    spread = ((r - radius) ** 2 * weight).sum(axis=0)
    volume, area = volume_and_area(*refine(tube, cuts=cuts))
    return {
        "length": float(station[-1]),
        "station": [float(v) for v in station],
        "radius": [float(v) for v in radius],
        "volume": volume,
        "area": area,
        "asymmetry": float(np.sqrt(spread.sum() / max((radius**2).sum(), 1e-30))),
    }


def map_agreement(
    tube: np.ndarray,
    camera: Camera,
    map_: Foreground,
    cuts: Sequence[Cut] = (),
    hidden: Hidden | None = None,
    others: Hidden | None = None,
) -> tuple[float, float]:
    """How far the map bears out a tube, shape (N_x, N_s, 3), and how sure the map is of itself, where it is not hidden.

    Parts that join in one colour have no edge between them: what the map has beyond the tube where others lie is theirs.

    Returns:
        Share of the tube's silhouette and the map's object together that they agree about to within a sample;
        share of what may be the object by the map that surely is.
    """
    mask = _silhouette(tube, camera, map_, cuts)
    labels, count = ndimage.label(map_.inside > 0.5)  # pyright: ignore
    shared, whole = (np.bincount(of, minlength=max(count, 1) + 1) for of in (labels[mask], labels.ravel()))
    # one piece of the map, but for a tube in several
    object_ = labels == 1 + shared[1:].argmax()
    if any(gap for _, gap in cuts):
        object_ |= np.isin(labels, 1 + np.flatnonzero(shared[1:] > 0.5 * whole[1:]))
    rows, columns = np.indices(mask.shape)
    points = np.stack([columns, rows], axis=-1) * map_.step + map_.origin
    seen, own = np.ones(mask.shape, bool), np.ones(mask.shape, bool)
    if hidden is not None:
        seen = ~hidden.near(points, 0.5 * map_.step)
    if others is not None:
        own = mask | np.logical_not(ndimage.binary_dilation(others.at(points)))
        object_ = object_ & own
    apart = sum(np.sum(a & np.logical_not(ndimage.binary_dilation(b)) & seen) for a, b in ((mask, object_), (object_, mask)))
    sure = (map_.inside > SURE) & seen
    maybe = (map_.inside > 1 - SURE) & seen & (own | sure)
    return float(1 - apart / max(((mask | object_) & seen).sum(), 1)), float(sure.sum() / max(maybe.sum(), 1))


def _silhouette(tube: np.ndarray, camera: Camera, map_: Foreground, cuts: Sequence[Cut]) -> np.ndarray:
    """The map's samples that the tube covers."""
    mask = np.zeros(map_.inside.shape, bool)
    for grid in smooth_pieces(tube, cuts=cuts):
        rows = np.unique([*range(0, grid.shape[1], 2), grid.shape[1] - 1])
        mask |= silhouette((camera.project(grid[::2, rows]) - np.array(map_.origin)) / map_.step, mask.shape)
    return mask


@dataclass(frozen=True)
class Support:
    """Of one piece of contour: which points lie on image data, how far from its edge, and what each stands for [px]."""

    supported: np.ndarray
    offset: np.ndarray
    length: np.ndarray

    def only(self, chosen: np.ndarray) -> Support:
        """That of chosen points, shape (n,), bool."""
        return Support(self.supported[chosen], self.offset[chosen], self.length[chosen])


def lengths(points: np.ndarray) -> np.ndarray:
    """Length of the line that each of its points (n, 2) stands for, shape (n,): points lie close where rings do."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) if len(points) else np.zeros(0)


def share_of(flags: np.ndarray, length: np.ndarray) -> float:
    """Share of a line's length with a flag, both shape (n,); 0 of nothing."""
    return float(length[flags].sum() / length.sum()) if length.sum() > 0 else 0.0


def support_measures(found: Sequence[Support], hidden: Sequence[np.ndarray] | None = None) -> dict[str, Any]:
    """Of all pieces of a contour: share that image data supports; mean, 95 % and largest distance to edges [image px].

    What is hidden, shape (n,) of each piece, counts for nothing but its share.
    """
    hidden = [np.zeros(len(s.supported), bool) for s in found] if hidden is None else hidden
    unseen = np.concatenate([*hidden, np.zeros(0, bool)])
    length = np.concatenate([*(s.length for s in found), np.zeros(0)])
    flags = np.concatenate([*(s.supported for s in found), np.zeros(0, bool)])[~unseen]
    offsets = np.abs(np.concatenate([*(s.offset for s in found), np.zeros(0)]))[~unseen][flags]
    residual = {
        name: float(f(offsets)) if len(offsets) else float("nan")
        for name, f in (("mean", np.mean), ("p95", lambda x: np.quantile(x, 0.95)), ("max", np.max))
    }
    return {
        "supported_share": share_of(flags, length[~unseen]),
        "hidden_share": share_of(unseen, length),
        "contour_residual_px": residual,
    }


def contour_support(
    points: np.ndarray, normals: np.ndarray, potential: Potential, inside: np.ndarray, half_width: float
) -> Support:
    """Looks for the nearest strong edge along the normal of each contour point.

    Args:
        points, normals: of the contour, shape (n, 2), image px.
        potential: the finest one.
        inside: foreground at the potential's samples, or zeros of shape (0, 0) where there is no map.
        half_width: of the object [px].

    Returns:
        supported: an edge lies within reach, strong beside the contour's typical one; offset to it [px].
    """
    step = potential.step
    reach = max(REACH * half_width, 3 * potential.sigma)
    t = np.arange(-np.ceil(reach / step * 2), np.ceil(reach / step * 2) + 1) * (step / 2)
    at = (points[:, None] + t[:, None] * normals[:, None] - np.array(potential.origin)) / step
    profile = _cubic(potential.magnitude, at)
    typical = np.quantile(profile.max(axis=1), 0.75) if len(points) else 0.0
    # the nearest strong edge; beside a busy ground it need not be the strongest
    inner = profile[:, 1:-1]
    edge = (inner >= profile[:, :-2]) & (inner >= profile[:, 2:]) & (inner > STRONG * typical)
    nearest = np.where(edge, np.abs(t[1:-1]), np.inf).argmin(axis=1)
    best = 1 + np.where(edge.any(axis=1), nearest, inner.argmax(axis=1))
    rows = np.arange(len(points))
    low, peak, high = profile[rows, best - 1], profile[rows, best], profile[rows, best + 1]
    curve = low - 2 * peak + high
    shift = np.where(curve < -1e-12, 0.5 * (low - high) / np.where(curve < -1e-12, curve, -1.0), 0.0)
    offset = np.interp(best + np.clip(shift, -1, 1), np.arange(len(t)), t)
    here = ndimage.map_coordinates(potential.magnitude, _at(points, potential), order=1, mode="constant")
    supported = (peak > STRONG * typical) & (here > 0.1 * typical) & (np.abs(offset) < max(1.5 * step, 0.06 * half_width))
    if inside.size:
        within = ndimage.map_coordinates(inside, _at(points - reach * normals, potential), order=1, mode="constant")
        beyond = ndimage.map_coordinates(inside, _at(points + reach * normals, potential), order=1, mode="constant")
        supported &= within - beyond > 0.2
    return Support(supported, offset, lengths(points))


def _cubic(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values at places (n, m, 2), (column, row), by cubic splines through those about them; 0 beyond the field."""
    if not at.size:
        return np.zeros(at.shape[:2])
    size = np.array(values.shape[::-1])
    first = np.clip(np.floor(at.min((0, 1))).astype(int) - RINGING, 0, size - 1)
    last = np.clip(np.ceil(at.max((0, 1))).astype(int) + RINGING, first, size - 1)
    part = values[first[1] : last[1] + 1, first[0] : last[0] + 1]
    return ndimage.map_coordinates(part, [at[..., 1] - first[1], at[..., 0] - first[0]], order=3, mode="constant")


def _at(points: np.ndarray, potential: Potential) -> np.ndarray:
    return ((points - np.array(potential.origin)) / potential.step).T[::-1]
