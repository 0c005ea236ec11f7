"""Where an object is hidden in a view, and what that makes of its potential."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .foreground import Foreground
from .potential import MAP_LED, Potential

GUESS = 0.2
"""Least share of what the map says of an object where it is hidden."""
NEAR, RISE = 1.0, 1.0
"""From a hidden pixel on, in blurs of the potential: how far beta stays 0, and over how far it rises to 1."""
MEETING = 2.0
"""The same, both, from where the outline of what lies behind meets the object's own."""


def window(box: np.ndarray, shape: tuple[int, ...], room: float = 0.0) -> tuple[slice, slice]:
    """Rows and columns of an image (H, W) that a box of image points, least and greatest (2, 2), holds, with room."""
    left, top = np.clip(np.floor(box[0] - room), 0, shape[1::-1]).astype(int).tolist()
    right, bottom = np.clip(np.ceil(box[1] + room) + 1, 0, shape[1::-1]).astype(int).tolist()
    return slice(top, bottom), slice(left, right)


def _rising(mask: np.ndarray, potential: Potential, near: float, rise: float) -> np.ndarray:
    """At a potential's samples, shape (h, w): 0 on a mask of them and `near` blurs further, 1 from `rise` more on."""
    rising = np.ones(mask.shape, np.float32)
    if not mask.any():
        return rising
    blur = np.sqrt(potential.sigma**2 + potential.step**2)
    ends = np.array([np.flatnonzero(mask.any(axis=a))[[0, -1]] for a in (0, 1)]).T
    part = window(ends, mask.shape, (near + rise) * blur / potential.step)
    off = np.asarray(ndimage.distance_transform_edt(~mask[part])) * potential.step
    rising[part] = np.clip((off / blur - near) / rise, 0.0, 1.0)
    return rising


def clear_of(meetings: np.ndarray, potential: Potential, map_: Foreground) -> np.ndarray:
    """What to multiply a potential's samples by, shape (h, w, 4), so that no edges count where outlines meet.

    Smoothed, an edge bends towards another that ends at it, by a pixel at a blur of one. Where the map alone leads
    nothing is changed, and its push on poles is left.

    Args:
        meetings: image points where the outline of what lies behind an object meets its own, shape (n, 2).
        potential: the object's.
        map_: the object's.
    """
    clear = np.ones((*potential.magnitude.shape, 4), np.float32)
    if potential.sigma > MAP_LED * map_.half_width:
        return clear
    column, row = np.rint((meetings - potential.origin) / potential.step).astype(int).T
    height, width = potential.magnitude.shape
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    if within.any():
        mask = np.zeros((height, width), bool)
        mask[row[within], column[within]] = True
        clear[..., :3] = _rising(mask, potential, MEETING, MEETING)[..., None]
    return clear


@dataclass(frozen=True)
class Hidden:
    """Where an object is hidden in a view."""

    mask: np.ndarray
    """shape (h, w), bool, at whole image points."""
    corner: tuple[int, int]
    """image point (column, row) of the first."""

    def near(self, points: np.ndarray, blur: float) -> np.ndarray:
        """Whether image points (..., 2) are hidden, or so near to it that its edge there is another's."""
        reach = int(np.ceil(NEAR * blur))
        if reach == 0 or not points.size:
            return self.at(points)
        # a mask may be as large as a photograph: only about the points
        flat = points.reshape(-1, 2) - self.corner
        rows, columns = window(np.stack([flat.min(axis=0), flat.max(axis=0)]), self.mask.shape, reach)
        wide = np.pad(self.mask[rows, columns], reach)
        if wide.any():
            wide = np.asarray(ndimage.distance_transform_edt(~wide)) <= NEAR * blur
        return Hidden(wide, (self.corner[0] + columns.start - reach, self.corner[1] + rows.start - reach)).at(points)

    def beta(self, potential: Potential) -> np.ndarray:
        """beta of (11) at a potential's samples, shape (h, w): 0 where hidden and nearby, where the edge is another's.

        It rises over `RISE` of the potential's blur from `NEAR` of it on, so that it changes little when the mask does.
        """
        h, w = potential.magnitude.shape
        points = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1) * potential.step + potential.origin
        return _rising(self.at(points), potential, NEAR, RISE)

    def seen_of(self, potential: Potential, map_: Foreground) -> np.ndarray:
        """A potential's samples, shape (h, w, 4), times beta; `GUESS` of the map's word is left where it is the best."""
        beta = said = self.beta(potential)
        if map_.guess is not None:
            h, w = beta.shape
            cols, rows = (
                (o + potential.step * np.arange(n) - m) / map_.step
                for o, n, m in zip(potential.origin, (w, h), map_.origin, strict=True)
            )
            guess = ndimage.map_coordinates(map_.guess, np.meshgrid(rows, cols, indexing="ij"), order=1, mode="constant")
            said = np.maximum(beta, GUESS * guess)
        return potential.samples * np.stack([beta, beta, said, said], axis=-1)

    @staticmethod
    def of(ignore: np.ndarray | None, besides: Hidden | None = None) -> Hidden | None:
        """What is not to be looked at, shape (H, W), bool, and what hides besides."""
        if ignore is None:
            return besides
        mask = ignore.copy()
        if besides is not None:
            (column, row), (height, width) = besides.corner, besides.mask.shape
            mask[row : row + height, column : column + width] |= besides.mask
        return Hidden(mask, (0, 0))

    def at(self, points: np.ndarray) -> np.ndarray:
        """Whether it is hidden at image points (..., 2); nowhere beyond the mask."""
        column, row = np.moveaxis(np.rint(points).astype(int) - self.corner, -1, 0)
        height, width = self.mask.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return inside & self.mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
