"""Images to scale space: the samples that the image force (11) looks up, one field a tube, view and sigma."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.special import gamma

from .camera import Camera
from .filters import correlation, derivatives, gaussian, smoothed
from .foreground import Foreground
from .problem import Settings, View
from .sampling import colours, resample

WIDE = 64.0
"""Most samples for an object's half width: finer images are sampled down, so that work does not grow with them."""
COARSE = 5.0
"""Most samples for a sigma: beyond, every second sample serves as well."""
FLOOR = 0.03
"""Share of the strongest edge below which an edge pulls less and less."""
PLAIN = 0.06
"""`ScaleSpace.plain` of outlines; a tube's flank beside what hides the rest needs all of the map's word."""
OVER = 0.12
"""The same over what lies behind, of whose colours the map is less sure: beside a faint edge half of its word is left."""
THIN, THICK = 4.0, 6.0
"""Depth of the map's object, in sigmas, below which its two edges disturb each other, and above which they do not."""
LOUDER, FURTHER = 0.1, 2.0
"""FLOOR of the map's word where the object is thin, and how much stronger the map's push is there."""
AROUND = 1.0
"""What is looked at beyond the map's object, in half widths."""
RANGE = 3.0
"""Longest pull, in sigmas."""
MAP_LED = 0.15
"""Sigma, in half widths of the object, above which the map alone leads."""
GATE = 2.5
"""Least smoothing of the map for its gate, in the map's own samples."""
COARSEST, FALL, FINEST, FINEST_PX = 0.3, 0.5, 0.014, 1.0
"""First sigma, ratio of one to the next, last sigma: in half widths of the object, the last not below FINEST_PX samples."""


SLOWLY = 0.3
"""Sigma, in half widths of the object, over which what shading adds to the pull is averaged along the outline."""
ON = 0.3
"""How far from an edge what is averaged may lie [blurs]."""
SPARSE = 4.0
"""Samples for the sigma of what is averaged so widely."""
STRAY = 0.06
"""How far what shading adds may depart from that average [blurs]."""
UNTOLD = 0.01
"""Share of the edges' squares that may be left out with channels, where they are, at every second sample."""
LIMB = math.sqrt(2) * float(gamma(0.75) / gamma(0.25))
"""Pull of a root of the distance to an edge, at the edge [sigmas]: grad P / P of its slope, convolved with a Gaussian."""


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
    """shape (h, w, 4): pull (column, row), pressure, pressure at a pole [image px]; for force "paper" the gradient of (11),
    times what makes it a unit spring at a step of unit contrast, and zeros."""
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


def fewer(image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """An image (h, w, channels) in as few channels as tell its edges where they have weight (h, w), but for `UNTOLD`.

    Turning the space of colours changes no sum over channels of squares of derivatives. Every second sample tells: what
    comes and goes between neighbours is noise.
    """
    half = image.shape[0] // 2 + 1, image.shape[1] // 2 + 1
    few, weight = (resample(v, np.zeros(2), 2.0, half) for v in (image, weight))
    ways = np.stack([np.diff(few, axis=1)[:-1], np.diff(few, axis=0)[:, :-1]]) * weight[:-1, :-1, None]
    ways = ways.reshape(-1, image.shape[2])
    squares, axes = np.linalg.eigh((ways.T @ ways).astype(float))
    first = int((np.cumsum(squares) <= UNTOLD * squares.sum()).sum())
    return image @ axes[:, min(first, len(squares) - 1) :].astype(np.float32) if first else image


def _gradient(values: np.ndarray) -> np.ndarray:
    """By columns and by rows, shape (2, h, w)."""
    rows, columns = np.gradient(values)
    return np.stack([columns, rows])


def _size(vectors: np.ndarray) -> np.ndarray:
    """Of vectors (2, h, w), shape (h, w)."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])


def _widely(values: np.ndarray, sigma: float) -> np.ndarray:
    """Values (h, w, channels) smoothed by a wide sigma [samples], of which every so many serve as well."""
    step = max(1.0, np.floor(sigma / SPARSE))
    h, w, channels = values.shape
    few = resample(values, np.zeros(2), step, (int(np.ceil((h - 1) / step)) + 1, int(np.ceil((w - 1) / step)) + 1))
    rest = math.sqrt(max(sigma**2 - 0.25 * (step**2 - 1), 1e-6)) / step
    few = np.stack([smoothed(few[..., i], rest) for i in range(channels)], axis=-1)
    return resample(few, np.zeros(2), 1 / step, (h, w), smooth=False)


class ScaleSpace:
    """The image round one tube in one view, and its potentials at any sigma.

    Args:
        view, camera, map_, settings: of the tube in the view.
        known: colours (h, w, channels) at the map's samples, for a quick look: where these are no finer than pixels
            they serve, and no more channels than tell the edges at the map's outline.
        plain: share of the map's word at the finest scale below which it says nothing.
    """

    def __init__(
        self,
        view: View,
        camera: Camera,
        map_: Foreground,
        settings: Settings,
        known: np.ndarray | None = None,
        plain: float = 0.0,
    ):
        self.settings, self.map, self.plain = settings, map_, plain
        quick = known if map_.step >= 1 else None
        self.step = max(1.0, map_.half_width / WIDE) if quick is None else map_.step
        self.origin, extent = self._box()
        cols, rows = (int(v) for v in np.floor(extent / self.step + 1e-6) + 1)
        self.shape = (rows, cols)
        if quick is not None:
            first = np.rint((self.origin - map_.origin) / self.step).astype(int)
            here = slice(first[1], first[1] + rows), slice(first[0], first[0] + cols)
            self.image, self.inside = quick[here], map_.inside[here]
            self.shape = self.inside.shape
        else:
            self.image, self.inside = self._sampled(view.image), self._at_step(map_.inside)
        if settings.potential == "brightness":
            self.image = self.image[..., :1]
        self.behind = None if map_.behind is None else self._at_step(map_.behind)
        self._outlines: dict[float, np.ndarray] = {}
        if known is not None and self.image.shape[2] > 1:
            self.image = fewer(self.image, self._gate(1.0))
        self.sigmas = sigma_list(map_.half_width, self.step, settings.sigmas)
        self.known = None
        if view.ignore is not None:
            self.known = resample((~view.ignore).astype(np.float32), self.origin, self.step, self.shape)

    def forget(self) -> None:
        """Lets go of what is made anew when one more potential is asked for."""
        self._outlines = {}
        for made in ("_half", "_depth", "_planes"):
            vars(self).pop(made, None)

    @cached_property
    def _half(self) -> ScaleSpace:
        """The same at half the samples a side."""
        half = copy.copy(self)
        half.forget()
        half.step = 2 * self.step
        half.shape = (self.shape[0] // 2 + 1, self.shape[1] // 2 + 1)
        half.image, half.inside = (resample(v, np.zeros(2), 2.0, half.shape) for v in (self.image, self.inside))
        if self.known is not None:
            half.known = resample(self.known, np.zeros(2), 2.0, half.shape)
        if self.behind is not None:
            half.behind = resample(self.behind, np.zeros(2), 2.0, half.shape)
        return half

    @cached_property
    def _depth(self) -> np.ndarray:
        """Depth in the map's object [samples]."""
        mask, depth = self.inside > 0.5, np.zeros(self.shape, np.float32)
        if mask.any():
            lo, hi = (f(np.argwhere(mask), axis=0) for f in (np.min, np.max))
            box = tuple(slice(max(a - 1, 0), b + 2) for a, b in zip(lo, hi, strict=True))
            depth[box] = ndimage.distance_transform_edt(mask[box])
        return depth

    def _sampled(self, image: np.ndarray) -> np.ndarray:
        """Colours of the part that is looked at; only its samples are converted."""
        pad = np.ceil(3 * self.step)
        first = np.maximum(np.floor(self.origin) - pad, 0).astype(int)
        last = np.ceil(self.origin + np.array(self.shape[::-1]) * self.step + pad).astype(int)
        part = image[first[1] : last[1] + 1, first[0] : last[0] + 1]
        return colours(resample(part, self.origin - first, self.step, self.shape))

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
        if self.step == m.step:
            first, last = np.floor(first), np.ceil(last)
        origin, extent = np.array(m.origin) + first * m.step, np.maximum(last - first, 8.0) * m.step
        # between the pixels would blur a small image more than its finest sigma does
        whole = np.floor(origin) if self.step == 1 else origin
        return whole, extent + origin - whole

    def _at_step(self, values: np.ndarray) -> np.ndarray:
        """What the map's samples hold, at these."""
        m = self.map
        return resample(values, (self.origin - m.origin) / m.step, self.step / m.step, self.shape, smooth=False)

    def _outline(self, sigma: float) -> np.ndarray:
        """The map smoothed by sigma [samples]; asked for again and again."""
        if sigma not in self._outlines:
            self._outlines[sigma] = smoothed(self.inside, sigma)
        return self._outlines[sigma]

    @cached_property
    def _planes(self) -> list[np.ndarray]:
        """Each channel of the image turned over, shape (w, h)."""
        return [np.ascontiguousarray(self.image[..., i].T) for i in range(self.image.shape[2])]

    def _edges(self, s: float, weight: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """P = weight |grad G*I| over all channels [1/sample] and weight grad |grad G*I|, shape (2, h, w); s in samples.

        By derivatives of the Gaussian, the second too: differences would blur once more what is finest.
        """
        h, w = self.shape
        once, twice = derivatives(s)
        columns = correlation(w, once, gaussian(s), twice)
        first, smooth, second = (correlation(h, kernel) for kernel in (once, gaussian(s), twice))
        p, slope = np.zeros((h, w), np.float32), np.zeros((2, h, w), np.float32)
        for plane in self._planes:
            along, plain, bent = (np.ascontiguousarray(v.T) for v in np.split(columns @ plane, 3))
            x, y, xy = smooth @ along, first @ plain, first @ along
            p += x * x + y * y
            slope[0] += x * (smooth @ bent) + y * xy
            slope[1] += x * xy + y * (second @ plain)
        p = np.sqrt(p)
        slope /= p + 1e-12
        if self.known is not None:
            weight = weight * self.known
        return weight * p, weight * slope

    def at(self, sigma: float, finest: bool = False) -> Potential:
        """The potential at a sigma [image px].

        Normalised: the pull is sigma^2 grad P / (P + floor), which for a smoothed step edge is the way to it in px
        whatever its contrast. With the map, P is gated by the map's outline, and what edges leave unsaid (at a coarse
        scale, everything) the map says, by a pressure outward inside the object and inward outside it.

        Args:
            sigma: of the smoothing.
            finest: the last one, whose pull is carried on to sigma 0 where there is a map.
        """
        if sigma > COARSE * self.step:
            return self._half.at(sigma, finest)
        sigma = float(sigma)  # numpy's scalars would make everything double
        s = sigma / self.step
        if self.settings.potential != "map":
            return self._edged(sigma, 1.0, None, finest)
        sure = 2 * self._outline(s) - 1
        if sigma <= MAP_LED * self.map.half_width or self.settings.force == "paper":
            return self._edged(sigma, self._gate(s), sure, finest)
        nothing = np.zeros_like(sure)
        p = 0.5 * _size(_gradient(sure))
        return self._potential(sigma, [nothing, nothing, self._pressure(sigma, sure), self._pole(sigma, sure)], p)

    def _edged(self, sigma: float, weight: np.ndarray | float, sure: np.ndarray | None, finest: bool) -> Potential:
        """The potential of weighted edges, and of the map's certainty (-1 outside, 1 inside) where there is one."""
        s = sigma / self.step
        p, slope = self._edges(s, weight)
        nothing = np.zeros_like(p)
        if self.settings.force == "paper":
            # per image px, as (11) says; one factor a scale, as if in beta
            unit = math.sqrt(2 * math.pi) * sigma**3
            return self._potential(sigma, [*(slope * unit / self.step**2), nothing, nothing], p)
        pull = self._pull(s, p, slope)
        thin = 0.0 if sure is None else self._thin(s)
        if finest and sure is not None:
            pull -= (1 - thin) * self._limb(s, weight, p, pull)
        pull *= np.minimum(1.0, RANGE * s / np.maximum(_size(pull), 1e-12)) * self.step
        if sure is None:
            return self._potential(sigma, [*pull, nothing, nothing], p)
        # in a tip either side's edge also draws the other side's contour: there the map must speak up
        loud = self._floor(p) * (1 + (LOUDER / FLOOR - 1) * thin)
        silent = loud / (p + loud)
        if finest:  # or the map, which is not so fine, would lead plain edges astray a little
            plain = self.plain if self.behind is None else np.maximum(self.plain, OVER * self.behind)
            silent = np.maximum(silent - plain, 0) / (1 - plain)
        unsaid = self._pressure(sigma, sure) * (1 + (FURTHER - 1) * thin) * silent
        return self._potential(sigma, [*pull, unsaid, self._pole(sigma, sure)], p)

    def _pull(self, s: float, p: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Way to the edge [samples], shape (2, h, w)."""
        return slope * (self._blur(s) ** 2 / (p + self._floor(p)))

    def _limb(self, s: float, weight: np.ndarray | float, p: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """What shading adds to the pull [samples], shape (2, h, w), from how it changes when the blur is doubled.

        Towards its outline a round object's shade falls as the root of the distance, which shifts the strongest
        slope of the smoothed edge inward. A step and y such roots, in shares of the slope at blur 1, pull by
        LIMB y / (1 + y) at blur 1 and by twice that of sqrt(2) y at blur 2; their difference gives y.
        """
        blur, two = self._blur(s), math.sqrt(2)
        wide = math.sqrt(s**2 + 3 * blur**2)
        p_wide, slope = self._edges(wide, weight)
        change = self._pull(wide, p_wide, slope) - pull
        size = _size(change) + 1e-12
        d = np.clip(size / (blur * LIMB), 0, 1)
        b = 2 * two - 1 - (1 + two) * d
        y = 2 * d / (b + np.sqrt(b**2 + 4 * two * (1 - d) * d) + 1e-12)
        # at the edge alone, where twice the blur halves a step and takes 1 / sqrt(2) of a root; beside it both grow
        at_edge = np.clip((p / (p_wide + 1e-12) - 1) / (two - 1), 0, 1)
        # shading changes slowly along the outline, texture and clutter do not
        normal = _gradient(self._outline(GATE * self.map.step / self.step))
        normal /= _size(normal) + 1e-12
        across = (change * normal).sum(axis=0) * (blur * LIMB * y / (1 + y) / size)
        off = (pull * normal).sum(axis=0) - at_edge * across
        here = p * at_edge * np.exp(-0.5 * (off / (ON * blur)) ** 2)
        wide = SLOWLY * self.map.half_width / self.step
        said, heard = np.moveaxis(_widely(np.stack([here * across, here], axis=-1), wide), -1, 0)
        mean = said / (heard + 1e-12)
        return normal * at_edge * (mean + np.clip(across - mean, -STRAY * blur, STRAY * blur))

    def _thin(self, s: float) -> np.ndarray:
        """1 where the map's object is less deep than `THIN` s nearby, 0 where it is deeper than `THICK` s; s in samples."""
        deepest = ndimage.maximum_filter(self._depth, 2 * int(np.ceil(1.3 * THICK * s)) + 1)
        return np.clip((THICK - deepest / s) / (THICK - THIN), 0, 1)

    def _blur(self, s: float) -> float:
        """Sigma [samples] of a step edge smoothed by `s`: the pixels' own extent and the resampling blur it too."""
        return math.sqrt(s**2 + 1 / 12 + 0.25 * (1 - 1 / self.step**2))

    @staticmethod
    def _floor(p: np.ndarray) -> float:
        return FLOOR * float(p.max()) + 1e-12

    @staticmethod
    def _pressure(sigma: float, sure: np.ndarray) -> np.ndarray:
        """Outward push [px]: an outline smoothed by sigma has slope 1 / (sigma sqrt(2 pi)), so a unit spring at it."""
        return math.sqrt(math.pi / 2) * sigma * sure

    def _pole(self, sigma: float, sure: np.ndarray) -> np.ndarray:
        """Push on a pole [px]; none on a plain outline, where the contour has its own force and a push would slide it."""
        wide = max(sigma / self.step, GATE * self.map.step / self.step)
        plain = math.sqrt(2 * math.pi) * wide * _size(_gradient(self._outline(wide)))
        return max(sigma, 2.5 * self.step) * sure * np.clip(1 - plain, 0, 1)

    def _gate(self, s: float) -> np.ndarray:
        """1 near the map's outline, 0 away from it; flat across it, so that the edges alone say where it is."""
        wide = self._outline(max(s, GATE * self.map.step / self.step))
        gate = np.clip((0.5 - np.abs(wide - 0.5)) / 0.15, 0, 1)
        return gate * gate * (3 - 2 * gate)

    def _potential(self, sigma: float, samples: list[np.ndarray], p: np.ndarray) -> Potential:
        channels = np.stack(samples, axis=-1).astype(np.float32)
        return Potential(sigma, channels, p, self.step, (float(self.origin[0]), float(self.origin[1])))
