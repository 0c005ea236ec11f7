"""Where a tube has gone that is not where it must be: the shift at which its silhouettes best cover its colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve

from .bend import linearised
from .palette import Palette
from .problem import View
from .surface import silhouette

GRAIN = 4.0
"""Samples for a half width."""
RIM = 1.0
"""What must not have the object's colours about the silhouette, in half widths."""
PULL = 0.5
"""What the farthest shift costs, in log odds of colour: of two places that look alike the nearer one."""
STEPS = 12
"""Shifts either way that are tried along each direction at first."""


def shifted(
    tube: np.ndarray, spine: np.ndarray, palettes: Sequence[Palette], views: Sequence[View], reach: float
) -> np.ndarray:
    """The world vector (3,) by which a tube is best moved, all views together; within `reach` half widths.

    Args:
        tube: shape (N_x, N_s, 3), world units.
        spine: shape (N_s, 3).
        palettes: its colours in each view.
        views: the frame's, and what is not to be looked at about the tube where it is.
        reach: how far it is looked for.
    """
    middle = spine.mean(axis=0)
    slopes = np.stack([linearised(view.camera, middle[None])[1][0] for view in views])
    tables: list[tuple[np.ndarray, float]] = [
        _worth(tube, palette, view, reach) for palette, view in zip(palettes, views, strict=True)
    ]
    far = reach * min(float(palette.half_width) for palette in palettes)
    # directions in which one unit moves it by a pixel in one view or more
    axes = np.linalg.svd(slopes.reshape(-1, 3))[2][: 2 if len(views) == 1 else 3]
    axes = axes / np.linalg.norm(slopes @ axes.T, axis=1).max(axis=0)[:, None]
    best, step, fine = np.zeros(3), far / STEPS, 0.5 * min(float(table[1]) for table in tables)
    ways = np.array(np.meshgrid(*[np.arange(-STEPS, STEPS + 1)] * len(axes))).reshape(len(axes), -1).T
    while True:
        tried = best + step * ways @ axes
        pixels = np.einsum("vij,nj->vni", slopes, tried)
        worth = sum(_looked_up(table, p) for table, p in zip(tables, pixels, strict=True))
        worth = worth / len(views) - PULL * (pixels**2).sum(axis=2).max(axis=0) / far**2
        best = tried[worth.argmax()]
        if step <= fine:
            return best
        step /= 4
        ways = np.array(np.meshgrid(*[np.arange(-4, 5)] * len(axes))).reshape(len(axes), -1).T


def _worth(tube: np.ndarray, palette: Palette, view: View, reach: float) -> tuple[np.ndarray, float]:
    """Mean log odds of colour within the silhouette less that of a rim about it, for each shift, and the samples' step."""
    step = palette.half_width / GRAIN
    points = view.camera.project(tube)
    flat, far = points.reshape(-1, 2), (reach + RIM) * palette.half_width
    origin = np.floor(flat.min(axis=0) - far)
    columns, rows = np.ceil((flat.max(axis=0) + far - origin) / step).astype(int) + 1
    odds = palette.odds(view.image, origin, step, (rows, columns))
    room = int(np.ceil(reach * palette.half_width / step))
    mask = silhouette((points - origin) / step, (rows, columns))
    about = np.asarray(ndimage.distance_transform_edt(~mask)) <= RIM * palette.half_width / step
    if view.ignore is not None:
        y, x = (np.clip(np.rint(origin[1 - i] + step * np.arange(n)).astype(int), 0, view.ignore.shape[i] - 1)
                for i, n in enumerate((rows, columns)))  # fmt: skip
        seen = ~view.ignore[np.ix_(y, x)]
        mask, about = mask & seen, about & seen
    about &= ~mask
    kernel = mask / max(mask.sum(), 1) - about / max(about.sum(), 1)
    part = slice(room, rows - room), slice(room, columns - room)
    return fftconvolve(odds, kernel[part][::-1, ::-1], mode="valid"), step


def _looked_up(table: tuple[np.ndarray, float], shift: np.ndarray) -> np.ndarray:
    """Worth of shifts (n, 2) [px]."""
    values, step = table
    middle = (np.array(values.shape[::-1]) - 1) / 2
    return ndimage.map_coordinates(values, (shift / step + middle).T[::-1], order=1, mode="nearest")
