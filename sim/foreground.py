"""How likely each pixel is to belong to the object: a random walker led by the image's own colours and the rough axis.

Colours near the axis and far from it make two histograms; their log likelihood ratio is the prior of a random walker
(Grady 2005) whose edges are the image's own. Made `ROUNDS` times, each time with the colours of the object found before,
led by the most likely ribbon about the axis from the second on. A thin one is looked at again at finer samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.interpolate import make_interp_spline
from skimage import measure
from threadpoolctl import threadpool_limits

from .ribbon import ribbon
from .sampling import resample, seen_colours
from .walk import Walk

AXIS = 130.0
"""Samples along the axis in the working image."""
ROUNDS = 4
SETTLED = 0.001
"""Share of the object by which a round may change it that is the last."""
CORE, FAR, MARGIN = 0.02, 0.45, 0.75
"""Surely object within, surely background beyond, image looked at within: distance to the axis / its length."""
PRIOR, SEED = 0.003, 10.0
"""Weights of prior and seeds against the image's edges."""
SHAPE, RIM = 4.0, 4.0
"""Log odds that the ribbon gives to what lies in it, against what lies out of it; its unsure rim to each side [samples]."""
UNEVEN, SLACK, SHORT = 1.5, 0.04, 0.2
"""Farthest that the object reaches to a side, times its width on the narrow one, plus lengths of the axis; past the ends."""
MIDDLE, SMOOTH, FAINT = 5, 1.0, 1e-6
"""Rounds in which the axis goes to the object's middle; smoothing along it, in half widths; samples of it that count."""
PAST = 1.5
"""How far past the image's border the axis is carried on, in half widths: there is room for the tube's end."""
ROUND, CLEAR = 0.4, 1.0
"""Smoothing of the map when it is done [samples]; log likelihood ratio of what is the object's wherever it is."""
FINE, FINEST, FINER = 16.0, 0.8, 1.2
"""Samples for a thin object's half width; least step [image px]; least gain in step that is worth a second look."""
AROUND, THIN_CORE, THIN_SLACK, THIN_ROUNDS = 3.0, 0.2, 0.3, 2
"""Of the second look, in half widths: background beyond; surely object within; slack of `UNEVEN`. Rounds."""
BROAD, LONGER = 0.33, 1.1
"""Half width, in lengths of the axis, of what `FAR` may have cut; looked at anew if its own axis is so much longer."""
MARK = 0.02
"""Radius of a mark, in lengths of the axis."""
BINS = {1: 32, 3: 16}
"""Cells of the histogram along each channel, by the count of channels."""


@dataclass(frozen=True)
class Foreground:
    """The map and where it lies in the image."""

    inside: np.ndarray
    """shape (h, w), in [0, 1]; 0.5 on the outline."""
    step: float
    """image pixels a sample."""
    origin: tuple[float, float]
    """image point (column, row) of sample (0, 0)."""
    length: float
    """of the axis on which it was made, the rough one or what that was carried on to [image px]."""
    half_width: float
    """median inside distance along the axis [image px]."""
    axis: np.ndarray
    """the smooth axis, carried on straight to the object's ends or past the image's border, shape (n, 2), image points."""
    guess: np.ndarray | None = None
    """1 where neither side of the object is seen, so that there is no better word than the map's, shape (h, w); else 0."""
    behind: np.ndarray | None = None
    """1 where another object lies behind, whose colours the map tells less well from its own, shape (h, w); else 0."""

    @property
    def box(self) -> np.ndarray:
        """Image points of the first sample and beyond the last, shape (2, 2)."""
        return np.array([self.origin, np.add(self.origin, np.multiply(self.step, self.inside.shape[::-1]))])

    def in_image(self, shape: tuple[int, int], origin: tuple[float, float] = (0.0, 0.0), step: float = 1.0) -> np.ndarray:
        """The map at samples from an image point on, a step [image px] apart, by default pixels; 0 where not looked at."""
        start, rate = (np.asarray(origin) - self.origin)[::-1] / self.step, step / self.step
        places = [x + rate * np.arange(n) for x, n in zip(start, shape, strict=True)]
        near = [np.flatnonzero((x >= 0) & (x <= n - 1)) for x, n in zip(places, self.inside.shape, strict=True)]
        out = np.zeros(shape, self.inside.dtype)
        if len(near[0]) and len(near[1]):
            first = np.array([places[1][near[1][0]], places[0][near[0][0]]])
            out[np.ix_(*near)] = resample(self.inside, first, rate, (len(near[0]), len(near[1])), smooth=False)
        return out


def axis_curve(points: np.ndarray, count: int = 200) -> np.ndarray:
    """Smooth curve through rough axis points, evenly spaced, shape (count, d).

    Args:
        points: shape (n, d), n >= 2.
        count: points wanted.
    """
    t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = make_interp_spline(t, points, k=min(3, len(points) - 1))
    fine = spline(np.linspace(0, t[-1], 20 * count))
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    want = np.linspace(0, arc[-1], count)
    return np.stack([np.interp(want, arc, fine[:, i]) for i in range(fine.shape[1])], axis=1)


def length_of(curve: np.ndarray) -> float:
    """Length of a polyline."""
    return float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())


def histogram(cells: np.ndarray, chosen: np.ndarray, channels: int) -> np.ndarray:
    """Smoothed share of the chosen pixels in each colour cell."""
    counts = np.bincount(cells[chosen], minlength=BINS[channels] ** channels).astype(np.float32)
    cube = counts.reshape((BINS[channels],) * channels)
    counts = ndimage.gaussian_filter(cube, BINS[channels] / 16, mode="nearest").ravel()
    return counts / max(counts.sum(), 1e-9)


def colour_cells(x: np.ndarray) -> np.ndarray:
    """Cell of the histogram that each sample of (h, w, channels) falls into, shape (h, w)."""
    channels = x.shape[2]
    bins = BINS[channels]
    low, high = x.min((0, 1)), x.max((0, 1))
    q = np.clip(((x - low) / (high - low + 1e-6) * bins).astype(int), 0, bins - 1)
    return np.asarray(np.ravel_multi_index(tuple(q[..., i] for i in range(channels)), (bins,) * channels))


def likelihood(cells: np.ndarray, mine: np.ndarray, known: np.ndarray, channels: int) -> np.ndarray:
    """Log likelihood ratio of each sample's colour: of what is mine over what is not, by what is known; shape (h, w)."""
    fore, back = histogram(cells, mine & known, channels), histogram(cells, ~mine & known, channels)
    return np.log((fore[cells] + 1e-7) / (back[cells] + 1e-7))


def _at_axis(inside: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The part of inside > 0.5 that holds the axis."""
    labels = np.asarray(measure.label(inside > 0.5, connectivity=1))
    ij = np.clip(np.rint(axis[:, ::-1]).astype(int), 0, np.array(inside.shape) - 1)
    hit = labels[ij[:, 0], ij[:, 1]]
    keep = np.unique(hit[hit > 0])
    return np.isin(labels, keep) if len(keep) else np.zeros(inside.shape, bool)


# vectors this short are slower shared between threads, much slower where cores are busy
@threadpool_limits.wrap(limits=1, user_api="blas")
def foreground(
    image: np.ndarray,
    axis: np.ndarray,
    ignore: np.ndarray | None = None,
    not_here: np.ndarray | None = None,
    others: Sequence[np.ndarray] = (),
) -> Foreground:
    """The foreground map of the object on a rough axis.

    Args:
        image: shape (H, W) or (H, W, 3), in [0, 1].
        axis: rough axis, shape (n, 2), image points (column, row).
        ignore: shape (H, W), True where colours must not be used.
        not_here: shape (k, 2), image points that are background.
        others: curves (n, 2) of image points in other objects, which are background here.

    Returns:
        The map on a crop round the axis, at `AXIS` samples for the axis' length; at `FINE` samples for the half width
        of a thin object; of a broad one, for the length of its own axis.
    """
    curve = axis_curve(axis)
    length = length_of(curve)
    marks = np.zeros((0, 2)) if not_here is None else np.asarray(not_here, float).reshape(-1, 2)
    look = _look(image, curve, length / AXIS, MARGIN * length, ignore)
    decide = len(marks) == 0
    core = look.off <= max(CORE * AXIS, 1.0)
    far = (look.off > FAR * AXIS) | look.near(marks, MARK * length) | look.along(others, max(CORE * AXIS, 1.0))
    found = look.found(_rounds(look, core, far, SLACK * AXIS, ROUNDS, decide), length)
    if found.half_width > BROAD * length and length_of(found.axis) > LONGER * length:
        return foreground(image, found.axis, ignore, not_here, others)
    half, step = found.half_width, max(found.half_width / FINE, FINEST)
    if step > look.step / FINER:
        return found
    look = _look(image, found.axis, step, AROUND * half, ignore)
    before = look.sampled(found)
    thin = THIN_CORE * half / step
    far = (_depth(before < 0.5) > AROUND * half / step) | look.near(marks, MARK * length) | look.along(others, thin)
    return look.found(_rounds(look, look.off <= thin, far, THIN_SLACK * half / step, THIN_ROUNDS, decide, before), length)


@dataclass(frozen=True)
class _Look:
    """The image round an axis, sampled."""

    x: np.ndarray
    """shape (h, w, channels)."""
    cells: np.ndarray
    """histogram cell of each sample's colour, shape (h, w)."""
    known: np.ndarray
    """what may be looked at, shape (h, w), bool."""
    line: np.ndarray
    """axis, shape (n, 2), samples."""
    off: np.ndarray
    """distance to the axis [samples], shape (h, w)."""
    place: np.ndarray
    """which of the axis' points is nearest, shape (h, w)."""
    step: float
    """image pixels a sample."""
    origin: np.ndarray
    """image point of sample (0, 0)."""

    def near(self, marks: np.ndarray, radius: float) -> np.ndarray:
        """Samples within a radius [image px] of marks, shape (k, 2), image points."""
        rows, cols = np.indices(self.off.shape)
        near = np.zeros(self.off.shape, bool)
        for p in (marks - self.origin) / self.step:
            near |= np.hypot(cols - p[0], rows - p[1]) <= radius / self.step
        return near

    def along(self, curves: Sequence[np.ndarray], radius: float) -> np.ndarray:
        """Samples within a radius [samples] of curves of image points, shape (n, 2) each."""
        near = np.zeros(self.off.shape, bool)
        for curve in curves:
            at = np.rint((curve - self.origin) / self.step).astype(int)
            at = at[np.all((at >= 0) & (at < self.off.shape[::-1]), axis=1)]
            near[at[:, 1], at[:, 0]] = True
        return near if not near.any() else np.asarray(ndimage.distance_transform_edt(~near)) <= radius

    def sampled(self, map_: Foreground) -> np.ndarray:
        """Another map at these samples."""
        rows, cols = (np.arange(n) * self.step + self.origin[1 - i] for i, n in enumerate(self.off.shape))
        at = np.meshgrid((rows - map_.origin[1]) / map_.step, (cols - map_.origin[0]) / map_.step, indexing="ij")
        return ndimage.map_coordinates(map_.inside, at, order=1, mode="nearest")

    def found(self, inside: np.ndarray, length: float) -> Foreground:
        """The walker's map with its outline made plain, and what it says of the object."""
        # an outline that is decided follows the corners of the samples, and no tip does
        soft = ndimage.gaussian_filter(_soft(inside), ROUND)
        half, axis = _half_width(soft, self.line, self.step, self.origin)
        return Foreground(soft, self.step, (float(self.origin[0]), float(self.origin[1])), length, half, axis)


def _look(image: np.ndarray, curve: np.ndarray, step: float, margin: float, ignore: np.ndarray | None) -> _Look:
    """The image within a margin [image px] about a curve of image points."""
    lo = np.maximum(np.floor(curve.min(0) - margin), 0.0)
    hi = np.minimum(np.ceil(curve.max(0) + margin), np.array(image.shape[1::-1]) - 1)
    width, height = (int(v) for v in np.maximum(np.floor((hi - lo) / step) + 1, 8))
    shape = (height, width)
    x, known = seen_colours(image, ignore, lo, step, shape)
    line = (curve - lo) / step
    return _Look(x, colour_cells(x), known, line, *_from_axis(line, shape), step, lo)


def _rounds(
    look: _Look, core: np.ndarray, far: np.ndarray, slack: float, rounds: int, decide: bool, before: np.ndarray | None = None
) -> np.ndarray:
    """The random walker's map, shape (h, w), in [0, 1].

    Args:
        look: the samples.
        core, far: surely object, surely background, shape (h, w), bool.
        slack: see `_reach` [samples].
        rounds: how often.
        decide: weigh edges anew, see `Walk.solve`; not with marks, which must spread over what looks like them.
        before: a map that is known already, shape (h, w).
    """
    core = core & ~far
    # what is surely background need not be solved for, but for a rim
    walk = Walk.on(look.x, ndimage.binary_dilation(~far, iterations=2), look.known)
    inside = core.astype(float) if before is None else before
    mine = core if before is None else _at_axis(before, look.line)
    centre, reach = look.line, np.full(len(look.line), np.inf)
    unsure = np.minimum(RIM + 1, _inland(core.shape))
    for k in range(rounds):
        again = k > 0 or before is not None
        ratio = likelihood(look.cells, mine, look.known, look.x.shape[2])
        odds = np.clip(0.5 * ratio, -6, 6)
        depth = np.zeros(core.shape)
        if again:
            within, centre = ribbon(look.x, odds, centre)
            depth = signed_depth(within, unsure)
            odds += SHAPE * np.clip(depth / RIM, -1, 1)
        prior = 1 / (1 + np.exp(-odds))
        # a click beside the object has put its seeds on the background's colours
        sure = core & (ratio > -1.0)
        beyond = far | ((look.off > reach[look.place]) & (ratio < CLEAR))
        prior[sure], prior[beyond] = 1.0, 0.0
        hold = np.where(look.known, PRIOR, 1e-6) + np.where(sure | beyond, SEED, 0.0)
        # not from the colours: so near to them that the walk would end before it has spread
        inside = walk.solve(hold, prior, inside, again and decide)
        last, mine = mine, _at_axis(inside, look.line) | sure
        reach = _reach(mine, look.line, slack)
        if again:
            mine = (mine | (depth > RIM)) & (depth > -RIM)
            if settled(last, mine):
                break
    return inside


def settled(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether a further round, with the colours of what was found, could change nothing worth its time."""
    return int((before ^ after).sum()) <= SETTLED * int(after.sum())


def _from_axis(line: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Of each sample: distance to the axis [samples] and which of the axis' points is nearest."""
    at = np.arange(4 * len(line) - 3) / 4
    column, row = (np.rint(np.interp(at, np.arange(len(line)), c)).astype(int) for c in line.T)
    index = np.full(shape, -1)
    index[np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)] = np.rint(at)
    off, near = ndimage.distance_transform_edt(index < 0, return_indices=True)  # pyright: ignore
    return off, index[near[0], near[1]]


def _depth(mask: np.ndarray, border: bool = True) -> np.ndarray:
    """Distance to the nearest sample outside [samples]; the image's border counts as outside, or not."""
    if not border and not mask.all():
        return np.asarray(ndimage.distance_transform_edt(mask))
    return np.asarray(ndimage.distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1]


def signed_depth(mask: np.ndarray, most: float | np.ndarray = np.inf) -> np.ndarray:
    """Distance to the border of a mask (h, w) [samples], above 0 within, at most so much, a number or (h, w); shape (h, w).

    The picture's own border is none.
    """
    depth = np.array(np.broadcast_to(-np.asarray(most, float), mask.shape))
    rows, columns = (np.flatnonzero(mask.any(axis=i)) for i in (1, 0))
    if len(rows):
        wide = int(min(np.max(most), max(mask.shape))) + 1
        part = tuple(slice(max(at[0] - wide, 0), at[-1] + wide + 1) for at in (rows, columns))
        near, limit = mask[part], -depth[part]
        inside, outside = ndimage.distance_transform_edt(near), ndimage.distance_transform_edt(~near)
        depth[part] = limit if near.all() else np.clip(np.asarray(inside) - np.asarray(outside), -limit, limit)
    return depth


def _inland(shape: tuple[int, ...]) -> np.ndarray:
    """Distance of each sample to the picture's border [samples]."""
    rows, columns = (np.minimum(np.arange(n), np.arange(n)[::-1]) + 1.0 for n in shape)
    return np.minimum(rows[:, None], columns)


def _reach(mine: np.ndarray, line: np.ndarray, slack: float) -> np.ndarray:
    """How far from each point of the axis the object may reach [samples]; `slack` on top of `UNEVEN` times its width.

    A roundish object is about as wide on one side of its axis as on the other, so what has leaked out on one side
    is cut off by the width of the other. Beyond its ends the axis may have been drawn short.
    """
    depth, length = _depth(mine, border=False), length_of(line)
    width = ndimage.map_coordinates(depth, line.T[::-1], order=1, mode="nearest")
    width = ndimage.maximum_filter1d(width, len(line) // 8, mode="nearest")
    reach = UNEVEN * width + slack
    along = np.linspace(0, length, len(line))
    return np.maximum(reach, SHORT * length - 2 * np.minimum(along, length - along))


def _soft(inside: np.ndarray) -> np.ndarray:
    """A soft threshold: without it the seeds leave a ridge that acts as a false edge."""
    return (1 / (1 + np.exp(-np.clip((inside - 0.5) / 0.1, -30, 30)))).astype(np.float32)


def _half_width(inside: np.ndarray, line: np.ndarray, step: float, lo: np.ndarray) -> tuple[float, np.ndarray]:
    mask, length = _at_axis(inside, line), length_of(line)
    if mask.any():
        line = _middle(mask, line)
    along = ndimage.map_coordinates(_depth(mask, border=False), line.T[::-1], order=1, mode="nearest")
    half = max(float(np.median(along)), 2.0)
    return half * step, carried_on(mask, line, length, half) * step + lo


def _middle(mask: np.ndarray, line: np.ndarray) -> np.ndarray:
    """The axis [samples] moved to the middle of the object: means of what is nearest to each point, again and again."""
    points = np.argwhere(mask)[:, ::-1].astype(float)
    half = 2 * _depth(mask)[mask].mean()  # of a strip
    ends = np.concatenate([points, line])  # no more need be looked at
    first = np.clip(np.floor(ends.min(axis=0)).astype(int), 0, None)
    mask = mask[first[1] : int(ends[:, 1].max()) + 2, first[0] : int(ends[:, 0].max()) + 2]
    line, points = line - first, points - first
    for _ in range(MIDDLE):
        _, place = _from_axis(line, mask.shape)
        nearest = place[mask]
        sums = np.stack([np.bincount(nearest, w, len(line)) for w in (points[:, 0], points[:, 1], np.ones(len(points)))])
        sums = ndimage.gaussian_filter1d(sums, SMOOTH * half * len(line) / length_of(line), mode="constant") + 1e-9
        line = axis_curve(np.where(sums[2] > FAINT, sums[:2] / sums[2], line.T).T, len(line))  # far from the object it stays
    return line + first


def carried_on(mask: np.ndarray, line: np.ndarray, length: float, half_width: float) -> np.ndarray:
    """The axis [samples] with both ends carried on straight while they stay on the object, by `length` at most.

    Where it leaves the image on the object, it goes on by `PAST` half widths [samples].
    """
    pieces = [line]
    quarter = len(line) // 4
    for end, inner in ((0, quarter), (-1, -1 - quarter)):
        e = line[end] - line[inner]
        run = line[end] + np.arange(1, len(line))[:, None] * (e / np.linalg.norm(e)) * (length / len(line))
        on = ndimage.map_coordinates(mask.astype(float), run.T[::-1], order=1, mode="constant") > 0.5
        steps = len(on) if on.all() else int(np.argmin(on))
        if steps < len(on) and ((run[steps] < 0) | (run[steps] > np.array(mask.shape[::-1]) - 1)).any():
            steps += int(PAST * half_width * len(line) / length)
        pieces = [run[:steps][::-1], *pieces] if end == 0 else [*pieces, run[:steps]]
    return np.concatenate(pieces)
