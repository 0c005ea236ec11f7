"""Near-axisymmetric solids with a known axis: circles swept along a bent line, as watertight meshes.

Lengths are in units of the axis' length here; `synthetic.make` scales and places the solid in its image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

KINDS = ("bent", "squash", "pear", "peanut", "bottle", "vase", "banana", "carrot", "tilted", "worm", "egg")
STEEPEST = 0.7
"""Largest radius over radius of curvature; at 1 the surface would fold at the inside of the bend."""


@dataclass(frozen=True)
class Sweep:
    """A solid before it is placed: an axis in the plane Z = 0 and a meridian around it."""

    station: np.ndarray
    """arc length along the axis of each point of the meridian, shape (m,), not falling, 0 to 1."""
    radius: np.ndarray
    """distance of the meridian from the axis, shape (m,), 0 at both ends."""
    axis: np.ndarray
    """points of the axis, shape (n, 2), at equal steps of arc length."""


def sweep(kind: str, rng: np.random.Generator) -> Sweep:
    """A solid of one of the KINDS with random proportions. ValueError for another name."""
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; it must be one of {', '.join(KINDS)}")
    if kind == "tilted":
        kind = ("bent", "pear", "peanut")[rng.integers(3)]
    body, caps, aspect, bend = _PROFILES[kind](rng)
    fine = (1 - np.cos(np.linspace(0, np.pi, 2001))) / 2  # round tips are steep
    station, radius = close(fine, body(fine) / body(fine).max() / (2 * aspect), caps)
    u = np.linspace(0, 1, 2001)
    turn = bend(u) * rng.choice([-1.0, 1.0])
    steepest = np.abs(turn * np.interp(u, station, radius)).max()
    return Sweep(station, radius, line(u, turn * min(1.0, STEEPEST / max(steepest, 1e-9))))


def mesh(
    solid: Sweep,
    around: int = 192,
    along: int = 256,
    out_of_round: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (around * (along - 2) + 2, 3) and faces (F, 3) of a solid, watertight, normals outward.

    Rings lie close where the meridian is curved. With `out_of_round` a ring's radius is
    r (1 + a2 cos(2t - p2) + a3 cos(3t - p3)); amplitudes and phases vary smoothly along the axis, and
    amplitudes are at most `out_of_round`.
    """
    station, radius = resample(solid, along)
    u = np.linspace(0, 1, len(solid.axis))
    slope = np.gradient(solid.axis, u, axis=0, edge_order=2)
    centre, tangent = (np.stack([np.interp(station, u, c) for c in of.T], 1) for of in (solid.axis, slope))
    angle = 2 * np.pi * np.arange(around) / around
    return tube(centre, tangent, radius[:, None] * sections(station, angle, out_of_round, rng))


def tube(centre: np.ndarray, tangent: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Watertight mesh of sections perpendicular to a line in the plane Z = 0, normals outward.

    `centre` and `tangent` are (n, 2); `radius` (n, k) holds k directions around, from the tangent's normal
    (-ty, tx) towards +Z. The first and last sections become single points. Vertices (2 + (n - 2) k, 3).
    """
    n, around = radius.shape
    angle = 2 * np.pi * np.arange(around) / around
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1) / np.linalg.norm(tangent, axis=1, keepdims=True)
    rings = np.empty((n, around, 3))
    rings[..., :2] = centre[:, None] + (radius * np.cos(angle))[..., None] * normal[:, None]
    rings[..., 2] = radius * np.sin(angle)
    poles = np.column_stack([centre[[0, -1]], np.zeros(2)])
    return np.concatenate([poles[:1], rings[1:-1].reshape(-1, 3), poles[1:]]), _faces(around, n - 2)


def _faces(around: int, rings: int) -> np.ndarray:
    """Triangles between `rings` rings of `around` vertices and a pole before the first and after the last."""
    first = 1 + np.arange(around)
    following = 1 + (np.arange(around) + 1) % around
    step = around * np.arange(rings - 1)[:, None]
    a, b = (step + first).ravel(), (step + following).ravel()
    pole, last = np.zeros(around, int), around * (rings - 1)
    return np.concatenate(
        [
            np.stack([pole, following, first], 1),
            np.stack([a, b, a + around], 1),
            np.stack([b, b + around, a + around], 1),
            np.stack([last + first, last + following, np.full(around, last + around + 1)], 1),
        ]
    )


def sections(
    station: np.ndarray,
    angle: np.ndarray,
    amount: float,
    rng: np.random.Generator | None,
) -> np.ndarray:
    """Factors on the radius, shape (stations, angles): 1 for circles; see `mesh`."""
    out = np.ones((len(station), len(angle)))
    if amount == 0:
        return out
    if rng is None:
        raise ValueError("sections out of round need a random generator: give rng")
    for order in (2, 3):
        knots = np.linspace(0, 1, 5)
        amplitude = PchipInterpolator(knots, rng.uniform(0.4, 1.0, 5))(station)
        phase = PchipInterpolator(knots, rng.uniform(0, 2 * np.pi) + rng.uniform(-0.6, 0.6, 5))(station)
        out += amount * amplitude[:, None] * np.cos(order * angle - phase[:, None])
    return out


def resample(solid: Sweep, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` points of the meridian: half of them spread by its length, half by its turning."""
    step = np.diff(np.stack([solid.station, solid.radius], 1), axis=0)
    length = np.linalg.norm(step, axis=1)
    keep = length > 0
    step, length = step[keep], length[keep]
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    turning = np.abs(np.gradient(heading)) + 1e-9
    weight = np.concatenate([[0], np.cumsum(length / length.sum() + turning / turning.sum())])
    points = np.flatnonzero(np.concatenate([[True], keep]))
    at = np.interp(np.linspace(0, weight[-1], count), weight, points)
    index = np.arange(len(solid.station))
    return np.interp(at, index, solid.station), np.interp(at, index, solid.radius)


def line(u: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Points (n, 2) of the plane curve of unit length with this curvature, by the trapezoidal rule."""
    h = u[1] - u[0]
    heading = np.concatenate([[0], np.cumsum((curvature[1:] + curvature[:-1]) * h / 2)])
    d = np.stack([np.cos(heading), np.sin(heading)], 1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum((d[1:] + d[:-1]) * h / 2, axis=0)])


def close(u: np.ndarray, radius: np.ndarray, caps: tuple[Cap, Cap]) -> tuple[np.ndarray, np.ndarray]:
    """Close the ends of a profile: stations and radii of the whole meridian, from radius 0 to radius 0."""
    station = u
    for cap in caps:
        station, radius = cap(station, radius)
        station, radius = (1 - station)[::-1], radius[::-1]
    return station, radius


class Cap:
    """How the meridian meets the axis at station 0."""

    def __call__(self, station: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The profile is closed already."""
        radius = radius.copy()
        radius[0] = 0.0
        return station, radius


class Round(Cap):
    """A dome, `depth` times as long as the end is wide; no jump of curvature where it begins."""

    def __init__(self, depth: float = 1.0):
        self.depth = depth

    def __call__(self, station: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c = self.depth * radius[0]
        s = np.concatenate([c * (1 - np.cos(np.linspace(0, np.pi / 2, 400))), station[station > c]])
        return s, np.interp(s, station, radius) * np.sqrt(np.clip(1 - np.clip(1 - s / c, 0, 1) ** 3, 0, 1))


class Flat(Cap):
    """A disc, its rim rounded by `fillet` times its radius."""

    def __init__(self, fillet: float = 0.08):
        self.fillet = fillet

    def __call__(self, station: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = self.fillet * radius[0]
        s = np.concatenate([f * (1 - np.cos(np.linspace(0, np.pi / 2, 100))), station[station > f]])
        r = np.interp(s, station, radius) - f + np.sqrt(np.clip(f**2 - np.clip(f - s, 0, f) ** 2, 0, None))
        disc = np.linspace(0, r[0], 60, endpoint=False)
        return np.concatenate([np.zeros(60), s]), np.concatenate([disc, r])


def _even(degrees: float):
    """Curvature of an arc that turns by so much."""
    return lambda u: np.full_like(u, np.radians(degrees))


def _smooth_step(u: np.ndarray, place: float, width: float) -> np.ndarray:
    return 0.5 * (1 + np.tanh((u - place) / width))


def _bump(u: np.ndarray, place: float, width: float) -> np.ndarray:
    return np.exp(-(((u - place) / width) ** 2))


# Each of these draws proportions and gives: profile(u), caps at u = 0 and 1, length over width, curvature(u).


def _bent(rng):
    belly, lean = rng.uniform(0.05, 0.6), rng.uniform(-0.2, 0.2)
    uneven, turn = rng.uniform(-0.5, 0.5), np.radians(rng.uniform(30, 95))
    return (
        lambda u: (1 - belly * (2 * u - 1) ** 2) * (1 + lean * (2 * u - 1)),
        (Round(rng.uniform(1.1, 1.8)), Round(rng.uniform(1.1, 1.8))),
        rng.uniform(3.0, 6.0),
        lambda u: turn * (1 + uneven * (2 * u - 1)),
    )


def _squash(rng):
    neck, second = rng.uniform(0.32, 0.45), rng.uniform(0.2, 0.35)
    place, turn = rng.uniform(0.22, 0.32), np.radians(rng.uniform(60, 110))
    return (
        lambda u: neck + (1 - neck) * _bump(u, 0.79, 0.2) + second * _bump(u, 0.5, 0.12),
        (Round(rng.uniform(0.9, 1.4)), Round(rng.uniform(1.1, 1.6))),
        rng.uniform(3.0, 4.2),
        lambda u: turn * _bump(u, place, 0.17) / (0.17 * np.sqrt(np.pi)),
    )


def _pear(rng):
    neck, place, width = rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.52), rng.uniform(0.12, 0.18)
    return (
        lambda u: neck + (1 - neck) * _smooth_step(u, place, width),
        (Round(rng.uniform(1.1, 1.5)), Round(rng.uniform(1.0, 1.4))),
        rng.uniform(2.2, 2.8),
        _even(rng.uniform(0, 25)),
    )


def _peanut(rng):
    waist, lean, place = rng.uniform(0.2, 0.42), rng.uniform(-0.15, 0.15), rng.uniform(0.44, 0.56)
    return (
        lambda u: (1 - waist * _bump(u, place, 0.16)) * (1 + lean * (2 * u - 1)),
        (Round(rng.uniform(1.2, 1.6)), Round(rng.uniform(1.2, 1.6))),
        rng.uniform(2.4, 3.4),
        _even(rng.uniform(0, 40)),
    )


def _bottle(rng):
    neck, place, width = rng.uniform(0.3, 0.42), rng.uniform(0.56, 0.68), rng.uniform(0.04, 0.07)
    return (
        lambda u: 1 - (1 - neck) * _smooth_step(u, place, width),
        (Flat(rng.uniform(0.1, 0.2)), Flat(rng.uniform(0.1, 0.2))),
        rng.uniform(2.8, 4.0),
        _even(0),
    )


def _vase(rng):
    foot, neck, rim = rng.uniform(0.5, 0.65), rng.uniform(0.42, 0.55), rng.uniform(0.7, 0.95)
    places = [0, 0.05, rng.uniform(0.32, 0.42), rng.uniform(0.74, 0.8), 1]
    # a cubic without corners: the monotone one is flat at each knot and shows as a band
    body = np.polynomial.Polynomial.fit(places, [foot, foot * 1.04, 1.0, neck, rim], 4)
    return body, (Flat(0.06), Flat(0.06)), rng.uniform(2.2, 2.8), _even(0)


def _banana(rng):
    power, turn, uneven = rng.uniform(0.65, 0.95), np.radians(rng.uniform(80, 125)), rng.uniform(-0.3, 0.3)
    return (
        lambda u: np.sin(np.pi * u).clip(0) ** power * (1 + 0.1 * (2 * u - 1)),
        (Cap(), Cap()),
        rng.uniform(4.0, 6.0),
        lambda u: turn * (1 + uneven * (2 * u - 1)),
    )


def _carrot(rng):
    power, shoulder = rng.uniform(0.75, 1.0), rng.uniform(0.4, 0.7)
    return (
        lambda u: (1 - u).clip(0) ** power,
        (Round(shoulder), Cap()),
        rng.uniform(3.5, 6.0),
        _even(rng.uniform(0, 30)),
    )


def _worm(rng):
    turn, phase, taper = np.radians(rng.uniform(55, 85)), rng.uniform(-0.4, 0.4), rng.uniform(-0.25, 0.25)
    return (
        lambda u: 1 + taper * (2 * u - 1),
        (Round(1.5), Round(1.5)),
        rng.uniform(7.0, 9.0),
        lambda u: np.pi * turn * np.sin(2 * np.pi * u + phase),
    )


def _egg(rng):
    lean = rng.uniform(0.05, 0.22)
    return (
        lambda u: np.sqrt((4 * u * (1 - u)).clip(0)) * (1 + lean * (2 * u - 1)),
        (Cap(), Cap()),
        rng.uniform(1.6, 2.2),
        _even(0),
    )


_PROFILES = {
    "bent": _bent,
    "squash": _squash,
    "pear": _pear,
    "peanut": _peanut,
    "bottle": _bottle,
    "vase": _vase,
    "banana": _banana,
    "carrot": _carrot,
    "worm": _worm,
    "egg": _egg,
}
