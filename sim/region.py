"""Foreground maps for outlines: led by what a rough closed curve encloses, where `foreground` is led by an axis."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage
from threadpoolctl import threadpool_limits

from . import foreground as walker
from .foreground import Foreground
from .sampling import seen_colours
from .walk import Walk

ACROSS = 110.0
"""Samples along the longer side of the curve's box."""
ROUNDS = 3
MARGIN = 1.0
"""Image looked at about the curve's box, in its longer side."""
CORE, FAR = 0.6, 1.0
"""Surely object as deep within the curve, surely not so far outside it, in its greatest depth."""
LEAN = 6.0
"""Log odds that the curve itself gives to what lies a greatest depth inside it, or against what lies so far outside."""
RIM, CERTAIN = 2, 4.0
"""Samples to each side of an outline that may have mixed colours; log likelihood ratio of a colour that is plainly one's."""
REACH = 0.12
"""Half width that stands for an open curve, over its length: what the first sigma goes by."""


def enclosed(points: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Samples within a closed polygon, shape (n, 2), (column, row); bool of `shape`."""
    picture = Image.new("1", (shape[1], shape[0]))
    ImageDraw.Draw(picture).polygon([(float(x), float(y)) for x, y in points], fill=1)
    return np.asarray(picture)


def _crop(points: np.ndarray, size: tuple[int, ...], across: float) -> tuple[np.ndarray, float, tuple[int, int]]:
    """First image point, step [px] and shape of the samples about a curve."""
    extent = float(np.ptp(points, axis=0).max())
    step = extent / across
    lo = np.maximum(np.floor(points.min(axis=0) - MARGIN * extent), 0.0)
    hi = np.minimum(np.ceil(points.max(axis=0) + MARGIN * extent), [size[1] - 1, size[0] - 1])
    width, height = (int(v) for v in np.maximum(np.floor((hi - lo) / step) + 1, 8))
    return lo, step, (height, width)


def _plain(ratio: np.ndarray, sure: np.ndarray, far: np.ndarray) -> bool:
    """Whether colours alone say of every sample whose it is, but for the rim between: then no walk can tell more.

    The object's must hang together, all that is surely object among them, and nothing like them lie elsewhere.
    """
    own = ratio > 0
    deep = walker._depth(own, border=False) + walker._depth(~own, border=False)  # 1 at the border between
    rim = deep <= RIM
    unsure = (np.abs(ratio) < CERTAIN) & ~rim
    return not (unsure | (sure & ~own) | (far & own)).any() and ndimage.label(own)[1] == 1  # pyright: ignore


@threadpool_limits.wrap(limits=1, user_api="blas")
def region_map(
    image: np.ndarray, points: np.ndarray, ignore: np.ndarray | None = None, not_here: np.ndarray | None = None
) -> Foreground:
    """The foreground map of the object that a rough closed curve encloses, for the most part.

    Args:
        image: shape (H, W) or (H, W, 3), in [0, 1].
        points: of the curve, shape (n, 2), image points (column, row).
        ignore: shape (H, W), True where colours must not be used.
        not_here: shape (k, 2), image points that are background.
    """
    lo, step, shape = _crop(points, image.shape, ACROSS)
    x, known = seen_colours(image, ignore, lo, step, shape)
    cells = walker.colour_cells(x)
    mine = enclosed((points - lo) / step, shape)
    within, beyond = walker._depth(mine), walker._depth(~mine, border=False)
    deepest = max(float(within.max()), 1.0)
    core, far = within >= CORE * deepest, beyond > FAR * deepest
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    marks = np.asarray([] if not_here is None else not_here, float).reshape(-1, 2)
    for p in (marks - lo) / step:
        far |= np.hypot(cols - p[0], rows - p[1]) <= walker.MARK * ACROSS
    core &= ~far
    walk, inside = None, mine.astype(float)
    lean = LEAN * (within**2 - beyond**2) / deepest**2
    for k in range(ROUNDS):
        ratio = walker.likelihood(cells, mine, known, x.shape[2])
        sure, alone = core & (ratio > -1.0), False
        if k == 0 and not len(marks) and known.all():
            anew = walker.likelihood(cells, ratio > 0, known, x.shape[2])
            alone = _plain(anew, sure, far)
            ratio = anew if alone else ratio
        prior = 1 / (1 + np.exp(-np.clip(np.clip(0.5 * ratio, -6, 6) + lean, -50, 50)))
        prior[sure], prior[far] = 1.0, 0.0
        if alone:
            inside, mine = prior, prior > 0.5
            break
        if walk is None:
            walk = Walk.on(x, ndimage.binary_dilation(~far, iterations=2), known)
        hold = np.where(known, walker.PRIOR, 1e-6) + np.where(sure | far, walker.SEED, 0.0)
        inside = walk.solve(hold, prior, inside if k > 0 else prior, k > 0 and len(marks) == 0)
        before, mine = mine, walker._at_axis(inside, np.argwhere(core)[:, ::-1].astype(float)) | sure
        if k > 0 and walker.settled(before, mine):
            break
    half = max(float(walker._depth(mine).max()), 2.0)
    # what leaves the image ends at its border, or a pressure would drive the curve on and on
    beside = int(np.ceil(half))
    inside = np.pad(walker._soft(inside), beside)
    length = float(np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1).sum())
    x0, y0 = (float(v) for v in lo - beside * step)
    return Foreground(inside, step, (x0, y0), length, half * step, points)


def no_map(image: np.ndarray, points: np.ndarray) -> Foreground:
    """What an open curve has instead: where to look and at which scales, and no object."""
    lo, step, shape = _crop(points, image.shape, ACROSS)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return Foreground(np.zeros(shape, np.float32), step, (float(lo[0]), float(lo[1])), length, REACH * length, points)
