"""Images to scale space: the samples that the image force (11) looks up, one field a tube, view and sigma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .camera import Camera
from .foreground import Foreground, colours, resample
from .problem import Settings, View

WIDE = 64.0
"""Most samples for an object's half width: finer images are sampled down, so that work does not grow with them."""
FLOOR = 0.03
"""Share of the strongest edge below which an edge pulls less and less."""
AROUND = 1.0
"""What is looked at beyond the map's object, in half widths."""
RANGE = 3.0
"""Longest pull, in sigmas."""
MAP_LED = 0.15
"""Sigma, in half widths of the object, above which the map alone leads."""
GATE = 2.5
"""Least smoothing of the map for its gate, in the map's own samples."""
COARSEST, FALL, FINEST, FINEST_PX = 0.3, 0.5, 0.014, 0.7
"""First sigma, ratio of one to the next, last sigma: in half widths of the object, the last not below FINEST_PX samples."""


@dataclass(frozen=True)
class PotentialPicture:
    """A potential (11) as in the paper's figure 8."""

    sigma: float
    """[image px]."""
    image: np.ndarray
    """shape (h, w), magnitude of the gradient or, at scales led by the map, its smoothed gradient."""
    extent: tuple[float, float, float, float]
    """image points (column, row) of first and last sample: x0, y0, x1, y1."""


@dataclass(frozen=True)
class Potential:
    """One tube's potential in one view at one sigma, ready for the kernels."""

    sigma: float
    """[image px]."""
    samples: np.ndarray
    """shape (h, w, 4): pull (column, row), pressure, pressure at a pole [image px]; for force "paper" the plain gradient
    of (11) and zeros."""
    magnitude: np.ndarray
    """shape (h, w), P of (11)."""
    step: float
    origin: tuple[float, float]

    @property
    def picture(self) -> PotentialPicture:
        """For display."""
        h, w = self.magnitude.shape
        x, y = self.origin
        return PotentialPicture(self.sigma, self.magnitude, (x, y, x + (w - 1) * self.step, y + (h - 1) * self.step))


def sigma_list(half_width: float, step: float, given: tuple[float, ...] | None) -> list[float]:
    """Falling sigmas [image px] for an object of a half width [image px] sampled at `step`."""
    if given is not None:
        return list(given)
    last = max(FINEST * half_width, FINEST_PX * step)
    sigma, out = COARSEST * half_width, []
    while sigma > 1.4 * last:
        out.append(sigma)
        sigma *= FALL
    return [*out, last]


class ScaleSpace:
    """The image round one tube in one view, and its potentials at any sigma."""

    def __init__(self, view: View, camera: Camera, map_: Foreground, settings: Settings):
        self.settings, self.map = settings, map_
        self.step = max(1.0, map_.half_width / WIDE)
        self.origin, extent = self._box()
        cols, rows = (int(v) for v in np.floor(extent / self.step) + 1)
        self.shape = (rows, cols)
        self.image = self._sampled(view.image)
        if settings.potential == "brightness":
            self.image = self.image[..., :1]
        self.inside = self._map_at_step()
        self.known = None
        if view.ignore is not None:
            self.known = resample((~view.ignore).astype(np.float32), self.origin, self.step, self.shape)

    def _sampled(self, image: np.ndarray) -> np.ndarray:
        """Colours of the part that is looked at; only that part of the image is converted."""
        pad = np.ceil(3 * self.step)
        first = np.maximum(np.floor(self.origin) - pad, 0).astype(int)
        last = np.ceil(self.origin + np.array(self.shape[::-1]) * self.step + pad).astype(int)
        part = image[first[1] : last[1] + 1, first[0] : last[0] + 1]
        return resample(colours(part), self.origin - first, self.step, self.shape)

    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """First image point and extent [px] of the part that is looked at: the map's object and what lies about it."""
        m = self.map
        h, w = m.inside.shape
        first, last = np.zeros(2), np.array([w, h]) - 1.0
        if self.settings.potential == "map":
            hit = np.argwhere(m.inside > 0.1)[:, ::-1]
            around = AROUND * m.half_width / m.step
            on = (m.axis - m.origin) / m.step
            first = np.maximum(first, np.minimum(hit.min(0, initial=w + h), on.min(0)) - around)
            last = np.minimum(last, np.maximum(hit.max(0, initial=0), on.max(0)) + around)
        return np.array(m.origin) + first * m.step, np.maximum(last - first, 8.0) * m.step

    def _map_at_step(self) -> np.ndarray:
        m = self.map
        cols, rows = ((self.origin[i] - m.origin[i] + self.step * np.arange(self.shape[1 - i])) / m.step for i in (0, 1))
        grid = np.meshgrid(rows, cols, indexing="ij")
        return ndimage.map_coordinates(self.map.inside, grid, order=1, mode="nearest").astype(np.float32)

    def _smooth(self, values: np.ndarray, sigma: float) -> np.ndarray:
        axes = (sigma, sigma) + (0,) * (values.ndim - 2)
        return ndimage.gaussian_filter(values, axes, mode="nearest", truncate=3.0)

    def _edges(self, sigma: float) -> np.ndarray:
        """|grad G*I| over all channels [1/sample], sigma in samples."""
        rows, cols = np.gradient(self._smooth(self.image, sigma), axis=(0, 1))
        p = np.sqrt((rows**2 + cols**2).sum(-1))
        return p if self.known is None else p * self.known

    def at(self, sigma: float) -> Potential:
        """The potential at a sigma [image px].

        Normalised: the pull is sigma^2 grad P / (P + floor), which for a smoothed step edge is the way to it in px
        whatever its contrast. With the map, P is gated by the map's outline, and what edges leave unsaid (at a coarse
        scale, everything) the map says, by a pressure outward inside the object and inward outside it.
        """
        s = sigma / self.step
        if self.settings.potential != "map":
            return self._edged(sigma, self._edges(s), None)
        sure = 2 * self._smooth(self.inside, s) - 1
        if sigma <= MAP_LED * self.map.half_width or self.settings.force == "paper":
            return self._edged(sigma, self._edges(s) * self._gate(s), sure)
        nothing = np.zeros_like(sure)
        rows, cols = np.gradient(0.5 * sure)
        p = np.hypot(rows, cols)
        return self._potential(sigma, [nothing, nothing, self._pressure(sigma, sure), self._pole(sigma, sure)], p)

    def _edged(self, sigma: float, p: np.ndarray, sure: np.ndarray | None) -> Potential:
        """The potential of edges of magnitude `p`, and of the map's certainty (-1 outside, 1 inside) where there is one."""
        s = sigma / self.step
        rows, cols = np.gradient(p)
        nothing = np.zeros_like(p)
        if self.settings.force == "paper":
            # per image px, as (11) says; P as it is
            return self._potential(sigma, [cols / self.step**2, rows / self.step**2, nothing, nothing], p)
        floor = FLOOR * float(p.max()) + 1e-12
        pull = np.stack([cols, rows]) * (s**2 / (p + floor))
        pull *= np.minimum(1.0, RANGE * s / np.maximum(np.linalg.norm(pull, axis=0), 1e-12)) * self.step
        if sure is None:
            return self._potential(sigma, [*pull, nothing, nothing], p)
        unsaid = self._pressure(sigma, sure) * floor / (p + floor)
        return self._potential(sigma, [*pull, unsaid, self._pole(sigma, sure)], p)

    @staticmethod
    def _pressure(sigma: float, sure: np.ndarray) -> np.ndarray:
        """Outward push [px]: an outline smoothed by sigma has slope 1 / (sigma sqrt(2 pi)), so a unit spring at it."""
        return np.sqrt(np.pi / 2) * sigma * sure

    def _pole(self, sigma: float, sure: np.ndarray) -> np.ndarray:
        """Push on a pole [px]; none on a plain outline, where the contour has its own force and a push would slide it."""
        wide = max(sigma, GATE * self.map.step) / self.step
        slope = np.hypot(*np.gradient(self._smooth(self.inside, wide), axis=(0, 1)))
        plain = np.sqrt(2 * np.pi) * wide * slope
        return max(sigma, 2.5 * self.step) * sure * np.clip(1 - plain, 0, 1)

    def _gate(self, s: float) -> np.ndarray:
        """1 near the map's outline, 0 away from it; flat across it, so that the edges alone say where it is."""
        wide = self._smooth(self.inside, max(s, GATE * self.map.step / self.step))
        gate = np.clip((0.5 - np.abs(wide - 0.5)) / 0.15, 0, 1)
        return gate * gate * (3 - 2 * gate)

    def _potential(self, sigma: float, samples: list[np.ndarray], p: np.ndarray) -> Potential:
        channels = np.stack(samples, axis=-1).astype(np.float32)
        return Potential(sigma, channels, p, self.step, (float(self.origin[0]), float(self.origin[1])))
