"""What was lost taken up again, however it has bent meanwhile: a region of its colours that is as large and as long."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from skimage import measure
from skimage.morphology import skeletonize

from .foreground import axis_curve, length_of
from .initial import frames, lift
from .palette import Palette
from .problem import View
from .sights import triangulated
from .surface import silhouette

GRAIN = 4.0
"""Samples for a half width."""
LARGE, LONG = (0.7, 1.4), (0.75, 1.3)
"""Area and length of the region, over those of the tube in its last frame."""
LEVEL = 0.3
"""Smoothing of the colours' odds, in half widths."""


def retaken(
    tube: np.ndarray, spine: np.ndarray, palettes: Sequence[Palette], views: Sequence[View], profiles: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray] | None:
    """The tube laid along the axis of the region that looks like it in every view; None where there is none in any.

    Args:
        tube: as it was last, shape (N_x, N_s, 3), world units.
        spine: shape (N_s, 3).
        palettes: its colours in each view.
        views: the frame's.
        profiles: lightness along it in each view (`profile`), which tells its first end from its last.
    """
    axes = []
    for palette, view, known in zip(palettes, views, profiles, strict=True):
        axis = _axis(palette, view, tube, spine)
        if axis is None:
            return None
        now = profile(view.image, axis_curve(axis, len(known)))
        axes.append(axis if _alike(now, known) >= _alike(now[::-1], known) else axis[::-1])
    camera = views[0].camera
    if len(views) == 1:
        line = lift(axes[0], camera, float(np.mean(camera.depth(spine))))
    else:
        line = triangulated(axes, [view.camera for view in views])
    return laid(tube, spine, line)


def profile(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Lightness of an image at points (n, 2)."""
    grey = image if image.ndim == 2 else image.mean(axis=2)
    return ndimage.map_coordinates(grey, points.T[::-1], order=1, mode="nearest")


def _alike(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)


def _axis(palette: Palette, view: View, tube: np.ndarray, spine: np.ndarray) -> np.ndarray | None:
    """Middle line (n, 2), image points, of the region that is most nearly as large as the tube, if it is about as long."""
    step = min(palette.half_width / GRAIN, 1.0)
    shape = tuple(int(np.ceil(n / step)) for n in view.image.shape[:2])
    odds = palette.odds(view.image, np.zeros(2), step, (shape[0], shape[1]))
    inside = ndimage.gaussian_filter(odds, LEVEL * palette.half_width / step) > 0
    if view.ignore is not None:
        inside &= ~view.ignore[np.ix_(*((np.arange(n) * step).astype(int) for n in shape))]
    points = view.camera.project(tube)
    low = points.reshape(-1, 2).min(axis=0)
    extent = np.ceil((points.reshape(-1, 2).max(axis=0) - low) / step).astype(int)[::-1] + 1
    large = float(silhouette((points - low) / step, tuple(extent)).sum())
    long = length_of(view.camera.project(spine))
    parts = [r for r in measure.regionprops(np.asarray(measure.label(inside))) if LARGE[0] < r.area / large < LARGE[1]]
    for part in sorted(parts, key=lambda r: abs(np.log(r.area / large))):
        line = _longest(skeletonize(np.pad(part.image, 1)))
        if len(line) < 8:
            continue
        line = ndimage.gaussian_filter1d(line, 0.5 * GRAIN, axis=0, mode="nearest") - 1 + np.array(part.bbox[:2])
        line = line[:, ::-1] * step
        line = np.concatenate([_ahead(line[::-1], palette.half_width)[::-1], line, _ahead(line, palette.half_width)])
        if LONG[0] < length_of(line) / long < LONG[1]:
            return line
    return None


def _ahead(line: np.ndarray, way: float) -> np.ndarray:
    """One point more after the last, straight on: a middle line ends before its region."""
    step = line[-1] - line[max(-len(line), -8)]
    return (line[-1] + 0.7 * way * step / max(float(np.linalg.norm(step)), 1e-12))[None]


def _longest(skeleton: np.ndarray) -> np.ndarray:
    """Pixels (n, 2), row and column, of the longest way through a skeleton, in order."""
    at = np.argwhere(skeleton)
    if len(at) < 2:
        return at.astype(float)
    number = np.full(skeleton.shape, -1)
    number[tuple(at.T)] = np.arange(len(at))
    rows, columns, ways = [], [], []
    for i, j in ((0, 1), (1, -1), (1, 0), (1, 1)):
        beside = number[at[:, 0] + i, at[:, 1] + j]
        here = np.flatnonzero(beside >= 0)
        rows, columns = [*rows, here], [*columns, beside[here]]
        ways.append(np.full(len(here), np.hypot(i, j)))
    graph = coo_array((np.concatenate(ways), (np.concatenate(rows), np.concatenate(columns))), shape=(len(at),) * 2).tocsr()
    off = dijkstra(graph, directed=False, indices=0)
    first = int(np.where(np.isfinite(off), off, -1).argmax())
    off, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    last = int(np.where(np.isfinite(off), off, -1).argmax())
    path = [last]
    while path[-1] != first:
        path.append(int(before[path[-1]]))
    return at[path].astype(float)


def laid(tube: np.ndarray, spine: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A tube (N_x, N_s, 3) and its spine laid along another line (n, 3), its rings as they stand to the spine."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(spine, axis=0), axis=1)))
    fine = axis_curve(line)
    new = np.stack([np.interp(arc / arc[-1], np.linspace(0, 1, len(fine)), column) for column in fine.T], axis=1)
    old = frames(spine)
    return new + sum(((tube - spine) * a).sum(axis=2)[..., None] * b for a, b in zip(old, frames(new), strict=True)), new
