"""Peer (b): a plain generalised cylinder, circles between sub-pixel edge points on both sides of the axis.

The clicked axis becomes a spline; on rays across it the largest gradient is found; the midpoints make a
better axis; it is walked on from both ends until the object ends, and then refined from tip to tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.ndimage import gaussian_filter, map_coordinates, median_filter, spline_filter

from symseek.scenes import shapes

SMOOTHING = 0.8
"""Gaussian before the gradient [px]."""
STATIONS = 121
STEEP = 3.0
"""Slopes of the radius above 1/3 count as a rounded end."""
REACH = 0.45
"""Longest ray of the first search, in lengths of the clicked line; round objects are 0.4 of it wide."""


@dataclass(frozen=True)
class _Picture:
    """A smoothed image as cubic B-spline coefficients."""

    coefficients: np.ndarray
    sign: float
    """+1 where the object is brighter than what is around it."""
    unit: float
    """lengths of the method count in this many pixels: 1/250 of the clicked line."""

    def at(self, points: np.ndarray) -> np.ndarray:
        """Brightness at points (..., 2) of (column, row), positive inside the object."""
        return self.sign * map_coordinates(
            self.coefficients,
            np.moveaxis(points, -1, 0)[::-1],
            order=3,
            prefilter=False,
            mode="nearest",
        )

    def fall(self, origin: np.ndarray, direction: np.ndarray, near: np.ndarray, far: np.ndarray, step: float):
        """Distances (n, k) along rays from near to far, and the fall of brightness per pixel there."""
        count = max(int(np.ceil((far - near).max() / step)), 4)
        d = near[:, None] + (far - near)[:, None] * np.linspace(0, 1, count)
        value = self.at(origin[:, None] + d[..., None] * direction[:, None])
        return d, -np.gradient(value, axis=1) / np.maximum((far - near) / (count - 1), 1e-9)[:, None]


@dataclass(frozen=True)
class _Tube:
    """Stations along an axis."""

    axis: np.ndarray
    """points, shape (n, 2)."""
    radius: np.ndarray
    """shape (n,) [px]."""

    @property
    def arc(self) -> np.ndarray:
        return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(self.axis, axis=0), axis=1))])

    @property
    def tangent(self) -> np.ndarray:
        t = np.gradient(self.axis, self.arc, axis=0, edge_order=2)
        return t / np.linalg.norm(t, axis=1, keepdims=True)

    @property
    def normal(self) -> np.ndarray:
        t = self.tangent
        return np.stack([-t[:, 1], t[:, 0]], 1)

    def at(self, stations: np.ndarray) -> _Tube:
        """The same tube at other arc lengths; the radius at tips falls like that of a ball."""
        line = CubicSpline(self.arc, self.axis)
        return _Tube(line(stations), np.sqrt(np.interp(stations, self.arc, self.radius**2)))


def reconstruct(
    image: np.ndarray,
    clicks: np.ndarray,
    around: int = 96,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Watertight mesh (V, 3), (F, 3) in pixels about depth 0, or None where it finds no two sides."""
    grey = image if image.ndim == 2 else image.mean(2)
    start = _clicked(clicks)
    unit = start.arc[-1] / 250
    smooth = gaussian_filter(grey.astype(float), SMOOTHING, mode="nearest")
    found = _first_sides(_Picture(spline_filter(smooth), 1.0, unit), start)
    if found is None:
        return None
    picture, left, right = found
    tube = _recentred(start, left, right)
    for window in (0.4, 0.2):
        tube = _recentred(tube, *_sides(picture, tube, window))
    tube = _walked_on(picture, tube)
    for window in (0.6, 0.5, 0.4, 0.3):
        tube = _clustered(_ends_met(picture, tube))
        tube = _recentred(tube, *_sides(picture, tube, window))
    tube = _clustered(_ends_met(picture, tube))
    left, right = _sides(picture, tube, 0.2)
    return _solid(tube, (left + right) / 2, around)


def _clicked(clicks: np.ndarray) -> _Tube:
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(clicks, axis=0), axis=1))])
    return _Tube(CubicSpline(t, clicks)(np.linspace(0, t[-1], STATIONS)), np.zeros(STATIONS))


def _first_sides(picture: _Picture, tube: _Tube) -> tuple[_Picture, np.ndarray, np.ndarray] | None:
    """Distances (n,) to both sides by the first strong edges, and the picture with its sign.

    None where fewer than six in ten rays meet an edge that stands out.
    """
    n = len(tube.axis)
    reach = np.full(2 * n, REACH * tube.arc[-1])
    origin, direction = np.tile(tube.axis, (2, 1)), np.concatenate([tube.normal, -tube.normal])
    d, fall = picture.fall(origin, direction, np.full(2 * n, 2.0), reach, 1.0)
    strongest = np.take_along_axis(fall, np.abs(fall).argmax(1)[:, None], 1)
    sign = 1.0 if np.median(strongest) > 0 else -1.0
    fall = sign * fall
    if np.mean(fall.max(1) > 6 * np.median(np.abs(fall))) < 0.6:
        return None
    ahead = np.column_stack([fall[:, 1:], np.full(2 * n, -np.inf)])
    summit = (fall > 0.5 * fall.max(1, keepdims=True)) & (fall >= ahead)
    distance = d[np.arange(2 * n), summit.argmax(1)]
    left, right = (_without_outliers(side) for side in (distance[:n], distance[n:]))
    return _Picture(picture.coefficients, sign, picture.unit), left, right


def _without_outliers(distance: np.ndarray) -> np.ndarray:
    """Distances along the tube with what jumps replaced by the median of neighbours."""
    usual = median_filter(distance, 15, mode="nearest")
    return np.where(np.abs(distance - usual) > 3 + 0.1 * usual, usual, distance)


def _sides(picture: _Picture, tube: _Tube, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) to both sides within a window [shares of the radius] around the expected radius."""
    slack = window * tube.radius + 3 * picture.unit
    near, far = np.maximum(tube.radius - slack, 0), tube.radius + slack
    left = _summit(*picture.fall(tube.axis, tube.normal, near, far, 0.5))
    return left, _summit(*picture.fall(tube.axis, -tube.normal, near, far, 0.5))


def _summit(d: np.ndarray, fall: np.ndarray) -> np.ndarray:
    """Distance (n,) of the largest fall on each ray, refined by a parabola."""
    rows = np.arange(len(d))
    k = np.clip(fall.argmax(1), 1, d.shape[1] - 2)
    a, b, c = fall[rows, k - 1], fall[rows, k], fall[rows, k + 1]
    bend = a - 2 * b + c
    shift = np.where(bend < 0, 0.5 * (a - c) / np.where(bend < 0, bend, 1), 0)
    return d[rows, k] + np.clip(shift, -1, 1) * (d[:, 1] - d[:, 0])


def _recentred(tube: _Tube, left: np.ndarray, right: np.ndarray) -> _Tube:
    """The axis through the midpoints, smoothed by a cubic spline.

    In a rounded end the midpoint of a chord says little about where the axis runs: such stations count
    little, and the spline's pieces are laid so that each is held by stations that count.
    """
    middle = tube.axis + tube.normal * ((left - right) / 2)[:, None]
    radius = median_filter((left + right) / 2, 5, mode="nearest")
    arc = tube.arc
    weight = 1 / (1 + (STEEP * np.gradient(radius, arc)) ** 4) + 1e-4
    held = np.concatenate([[0], np.cumsum((weight[1:] + weight[:-1]) / 2 * np.diff(arc))])
    pieces = int(np.clip(0.7 * held[-1] / np.median(radius), 1, 12))
    inner = np.interp(np.linspace(0, held[-1], pieces + 1)[1:-1], held, arc)
    t = np.concatenate([np.full(4, arc[0]), inner, np.full(4, arc[-1])])
    return _Tube(make_lsq_spline(arc, middle, t, w=weight)(arc), (left + right) / 2)


def _walked_on(picture: _Picture, tube: _Tube) -> _Tube:
    """The tube lengthened at both ends, station by station, until the axis leaves the object."""
    across = tube.normal * tube.radius[:, None]
    inside, outside = (np.median(picture.at(tube.axis + share * across)) for share in (0.85, 1.15))
    for _ in range(2):
        axis, radius = _walk(picture, tube, outside + 0.25 * (inside - outside))
        tube = _Tube(np.concatenate([tube.axis, axis])[::-1], np.concatenate([tube.radius, radius])[::-1])
    return tube


def _walk(picture: _Picture, tube: _Tube, floor: float) -> tuple[np.ndarray, np.ndarray]:
    """Stations beyond the tube's last one, points (m, 2) and radii (m,).

    As long as the axis is brighter than half way between both sides of the edges beside it, and than `floor`.
    """
    step = 2.0 * picture.unit
    even = tube.at(np.arange(tube.arc[-1] % step, tube.arc[-1] + 1e-9, step))
    points, radii = list(even.axis), list(even.radius)
    known = len(points)
    memory = int(np.clip(1.2 * radii[-1] / step, 12, known))  # wide things bend slowly
    while len(points) - known < 0.5 * tube.arc[-1] / step:
        recent = np.array(points[-memory:])
        x = np.arange(1 - len(recent), 1)
        bend = np.polynomial.polynomial.polyfit(x, recent, 2)
        ahead = bend[0] + bend[1] + bend[2]
        heading = bend[1] + 2 * bend[2]
        heading /= np.linalg.norm(heading)
        normal = np.array([[-heading[1], heading[0]], [heading[1], -heading[0]]])
        r = max(2 * radii[-1] - radii[-2], 0.5 * radii[-1], 1.0)
        origin = np.stack([ahead, ahead])
        near, far = np.full(2, max(0.4 * r, r - 6 * picture.unit)), np.full(2, r + 4 * picture.unit)
        sides = _summit(*picture.fall(origin, normal, near, far, 0.5))
        edge = origin + sides[:, None] * normal
        level = picture.at(np.stack([edge - 3 * SMOOTHING * normal, edge + 3 * SMOOTHING * normal])).mean()
        if picture.at(ahead[None])[0] < max(level, floor):
            break
        trust = 0.5 / (1 + (STEEP * (sides.mean() - radii[-1]) / step) ** 4)
        points.append(ahead + trust * normal[0] * (sides[0] - sides[1]) / 2)
        radii.append(sides.mean())
    return np.array(points[known:]).reshape(-1, 2), np.array(radii[known:])


def _ends_met(picture: _Picture, tube: _Tube) -> _Tube:
    """The tube cut or lengthened so that it ends where brightness falls most along the axis."""
    m = np.full(1, 6.0 * picture.unit)
    for _ in range(2):
        end, ahead = tube.axis[-1:], tube.tangent[-1:]
        beyond = _summit(*picture.fall(end, ahead, -m, m, 0.5))[0]
        arc = tube.arc
        stations = arc[arc < arc[-1] + min(beyond, 0) - 0.5]
        kept = tube.at(stations)
        tip = end + beyond * ahead if beyond > 0 else tube.at(np.array([arc[-1] + beyond])).axis
        tube = _Tube(np.concatenate([kept.axis, tip])[::-1], np.concatenate([kept.radius, [0.0]])[::-1])
    return tube


def _clustered(tube: _Tube) -> _Tube:
    """The tube at STATIONS stations, dense at the tips."""
    return tube.at(tube.arc[-1] * (1 - np.cos(np.linspace(0, np.pi, STATIONS))) / 2)


def _solid(tube: _Tube, radius: np.ndarray, around: int) -> tuple[np.ndarray, np.ndarray]:
    """Circles of these radii; where two edges are too close to tell apart it falls straight to the tip."""
    arc = tube.arc
    wide = np.flatnonzero(radius > 2 * SMOOTHING)
    wide = wide[(wide > 0) & (wide < len(arc) - 1)]
    known = np.concatenate([[0], wide, [len(arc) - 1]])
    radius = np.interp(arc, arc[known], np.where(np.isin(known, wide), radius[known], 0))
    return shapes.tube(tube.axis, tube.tangent, np.repeat(radius[:, None], around, axis=1))
