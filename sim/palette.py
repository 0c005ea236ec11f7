"""The foreground map of a frame, made cheaply: colours kept from the first one, the region from where the tube must be."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .foreground import BINS, FINE, FINEST, ROUND, SHAPE, Foreground, histogram, signed_depth
from .problem import View
from .sampling import colours, resample, tinted
from .surface import silhouette

AROUND = 2.0
"""What is looked at beyond the tube, in half widths."""
SLACK = 0.5
"""How far from the tube's own outline the colours alone decide, in half widths."""
BLUR = 1.2
"""Smoothing of the colours' odds [samples]."""
SURE = 4.0
"""Most that a sample's colour can say, in log odds."""


class Palette:
    """What tells an object from what is around it in one view.

    Args:
        view: of the first frame.
        map_: the object's foreground map in it.
    """

    def __init__(self, view: View, map_: Foreground):
        self.camera = view.camera
        self.half_width, self.length = map_.half_width, map_.length
        self.step = max(map_.half_width / FINE, FINEST)
        low, high = map_.axis.min(axis=0), map_.axis.max(axis=0)
        x, origin = self._sampled(view.image, low, high, AROUND * self.half_width)
        x = tinted(x)
        rows, cols = (np.arange(n) * self.step + origin[1 - i] for i, n in enumerate(x.shape[:2]))
        at = np.meshgrid((rows - map_.origin[1]) / map_.step, (cols - map_.origin[0]) / map_.step, indexing="ij")
        mine = ndimage.map_coordinates(map_.inside, at, order=1, mode="constant") > 0.5
        self.low = x.min(axis=(0, 1))
        self.bin = (x.max(axis=(0, 1)) - self.low + 1e-6) / BINS[x.shape[2]]
        cells, known = self._cells(x), _known(view, origin, self.step, (x.shape[0], x.shape[1]))
        fore, back = (histogram(cells, part & known, x.shape[2]) for part in (mine, ~mine))
        self.ratio = np.clip(np.log((fore + 1e-7) / (back + 1e-7)), -2 * SURE, 2 * SURE).astype(np.float32)

    def map(self, view: View, tube: np.ndarray, spine: np.ndarray, wide: float = 1.0) -> tuple[Foreground, np.ndarray]:
        """The map of another frame, and the colours (h, w, channels) of its samples.

        Args:
            view: its image and what is not to be looked at; there the map is the tube's own silhouette.
            tube: where the object must be about, shape (N_x, N_s, 3), world units.
            spine: shape (N_s, 3).
            wide: how much further than `SLACK` from it colours alone decide.
        """
        points = self.camera.project(tube)
        flat = points.reshape(-1, 2)
        x, origin = self._sampled(view.image, flat.min(axis=0), flat.max(axis=0), AROUND * max(1.0, wide) * self.half_width)
        shape = (x.shape[0], x.shape[1])
        within = silhouette((points - origin) / self.step, shape)
        depth = signed_depth(within) * self.step / (wide * SLACK * self.half_width)
        odds = np.where(_known(view, origin, self.step, shape), 0.5 * self.ratio[self._cells(tinted(x))], 0.0)
        odds = ndimage.gaussian_filter(odds, BLUR, mode="nearest")
        odds += SHAPE * np.sign(depth) * np.maximum(np.abs(depth) - 0.5, 0)
        inside = 1 / (1 + np.exp(-np.clip(2 * odds, -30, 30)))
        inside = ndimage.gaussian_filter(inside, ROUND, mode="nearest").astype(np.float32)
        axis = self.camera.project(spine)
        place = (float(origin[0]), float(origin[1]))
        return Foreground(inside, self.step, place, self.length, self.half_width, axis), x

    def odds(self, image: np.ndarray, origin: np.ndarray, step: float, shape: tuple[int, int]) -> np.ndarray:
        """Log odds of the colours at samples of an image from an image point on; beyond the image least."""
        first = np.clip(np.floor(origin), 0, np.array(image.shape[1::-1]) - 9).astype(int)
        last = np.clip(np.ceil(origin + step * np.array(shape[::-1])), first + 8, np.array(image.shape[1::-1]) - 1).astype(
            int
        )
        part = image[first[1] : last[1] + 1, first[0] : last[0] + 1]
        said = 0.5 * self.ratio[self._cells(tinted(colours(resample(part, origin - first, step, shape))))]
        rows, cols = (origin[1 - i] + step * np.arange(n) for i, n in enumerate(shape))
        inside = [(at >= -0.5) & (at <= n - 0.5) for at, n in zip((rows, cols), image.shape, strict=False)]
        return np.where(np.logical_and.outer(*inside), said, -SURE)

    def seen(self, map_: Foreground, tube: np.ndarray) -> float:
        """How far a tube, shape (N_x, N_s, 3), and a map's object are one: the less of what each holds of the other.

        Of what lies in the image; a tube that has shrunk to a part of the object is not it.
        """
        points = (self.camera.project(tube) - np.array(map_.origin)) / map_.step
        within = silhouette(points, map_.inside.shape)
        both = float(map_.inside[within].sum())
        return both / max(float(within.sum()), float(map_.inside.sum()), 1.0)

    def _sampled(self, image: np.ndarray, low: np.ndarray, high: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Colours (h, w, channels) about a box of image points, and the image point of sample (0, 0)."""
        h, w = image.shape[:2]
        first = np.clip(np.floor(low - margin), 0, [w - 9, h - 9]).astype(int)
        last = np.clip(np.ceil(high + margin), first + 8, [w - 1, h - 1]).astype(int)
        part = image[first[1] : last[1] + 1, first[0] : last[0] + 1]
        cols, rows = np.maximum(((last - first) / self.step + 1).astype(int), 8)
        return colours(resample(part, np.zeros(2), self.step, (rows, cols))), first.astype(float)

    def _cells(self, x: np.ndarray) -> np.ndarray:
        q = np.clip(((x - self.low) / self.bin).astype(int), 0, BINS[x.shape[2]] - 1)
        return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(q, 2, 0)), (BINS[x.shape[2]],) * x.shape[2]))


def _known(view: View, origin: np.ndarray, step: float, shape: tuple[int, int]) -> np.ndarray:
    """Samples (h, w), bool, that may be looked at."""
    if view.ignore is None:
        return np.ones(shape, bool)
    return resample((~view.ignore).astype(np.float32), origin, step, shape) > 0.5
