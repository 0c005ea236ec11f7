"""Values and colours of an image at the samples of another grid."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from skimage import color

TINT, DARK = 3.0, 1.0
"""Weight of tint against lightness at lightness 0.5; added to the lightness (white is 1) that divides the tint."""


def resample(values: np.ndarray, origin: np.ndarray, step: float, shape: tuple[int, int], smooth: bool = True) -> np.ndarray:
    """Values at image points origin + step * (column, row), linear between them; border values beyond the image.

    Args:
        values: shape (H, W) or (H, W, channels).
        origin: image point (column, row) of the first sample.
        step: pixels a sample.
        shape: rows and columns of samples.
        smooth: against aliases, by a Gaussian, when step > 1.

    Returns:
        float32, shape (*shape) or (*shape, channels).
    """
    h, w = values.shape[:2]
    (x, y), (rows, columns) = (int(v) for v in origin), shape
    if step == 1 and (x, y) == tuple(origin) and min(x, y) >= 0 and x + columns <= w and y + rows <= h:
        return values[y : y + rows, x : x + columns].astype(np.float32)
    sigma = 0.5 * np.sqrt(max(step**2 - 1, 0.0)) if smooth else 0.0
    lines = (_line(n, origin[i] + step * np.arange(shape[1 - i]), sigma) for i, n in ((1, h), (0, w)))
    (top, bottom, down), (left, right, across) = lines
    part = values[top:bottom, left:right].astype(np.float32)
    h, w = part.shape[:2]
    half = (down @ part.reshape(h, -1)).reshape(rows, w, -1)
    half = np.ascontiguousarray(half.transpose(1, 0, 2)).reshape(w, -1)
    out = (across @ half).reshape(columns, rows, -1).transpose(1, 0, 2)
    return np.ascontiguousarray(out).reshape(*shape, *values.shape[2:])


def _line(n: int, places: np.ndarray, sigma: float) -> tuple[int, int, csr_array]:
    """First and end of the values used at rising places (count,), and weights (count, used): linear, of smoothed ones."""
    reach = int(3 * sigma + 0.5)
    smooth = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-12)) ** 2)
    smooth /= smooth.sum()
    at = np.clip(places, 0, n - 1)
    below = np.floor(at).astype(int)
    share = (at - below)[:, None]
    weight = (1 - share) * np.append(smooth, 0.0) + share * np.append(0.0, smooth)
    beside = np.clip(below[:, None] + np.arange(-reach, reach + 2), 0, n - 1)
    first, last = int(beside[0, 0]), int(beside[-1, -1]) + 1
    ends = np.arange(0, weight.size + 1, weight.shape[1])
    used = (weight.ravel().astype(np.float32), beside.ravel() - first, ends)
    return first, last, csr_array(used, shape=(len(at), last - first))


def colours(image: np.ndarray) -> np.ndarray:
    """Lab over (100, 180, 180) of a colour image, grey as it is: shape (H, W, channels), differences of order one."""
    if image.ndim == 2:
        return image[..., None].astype(np.float32)
    if max(np.abs(image[..., 0] - image[..., i]).max() for i in (1, 2)) < 1e-3:
        return image[..., :1].astype(np.float32)
    return (color.rgb2lab(image) / np.array([100.0, 180.0, 180.0])).astype(np.float32)


def tinted(x: np.ndarray) -> np.ndarray:
    """Lightness, and stronger tints that shade dims less: a round object's lightness varies more than its dye."""
    if x.shape[2] == 1:
        return x
    return x * np.concatenate([np.ones_like(x[..., :1]), *2 * [TINT * (0.5 + DARK) / (x[..., :1] + DARK)]], axis=2)


def filled(x: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Samples (h, w, channels) with those that are not known like the nearest that are: no edge may part them."""
    near = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    assert near is not None
    return x[near[0], near[1]]


def seen_colours(
    image: np.ndarray, ignore: np.ndarray | None, origin: np.ndarray, step: float, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Tinted colours (h, w, channels) at samples of an image, and which may be looked at, (h, w), bool.

    Args:
        image: shape (H, W) or (H, W, 3), in [0, 1].
        ignore: shape (H, W), bool, or None.
        origin: image point (column, row) of the first sample, within the image.
        step: image pixels a sample.
        shape: (h, w).
    """
    # what smoothing before the sampling looks at, and no more: images are large
    pad = int(np.ceil(3 * step)) + 2
    first = np.maximum(origin.astype(int) - pad, 0)
    last = np.ceil(origin + step * np.array(shape[::-1])).astype(int) + pad
    part = slice(first[1], last[1]), slice(first[0], last[0])
    x = tinted(resample(colours(image[part]), origin - first, step, shape))
    if ignore is None:
        return x, np.ones(shape, bool)
    known = resample((~ignore[part]).astype(np.float32), origin - first, step, shape) > 0.5
    return filled(x, known), known
