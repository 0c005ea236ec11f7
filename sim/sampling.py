"""Values of an image at the samples of another grid."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array


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
    sigma = 0.5 * np.sqrt(max(step**2 - 1, 0.0)) if smooth else 0.0
    lines = (_line(n, origin[i] + step * np.arange(shape[1 - i]), sigma) for i, n in ((1, h), (0, w)))
    (top, bottom, rows), (left, right, columns) = lines
    part = values[top:bottom, left:right].astype(np.float32)
    h, w = part.shape[:2]
    half = (rows @ part.reshape(h, -1)).reshape(shape[0], w, -1)
    half = np.ascontiguousarray(half.transpose(1, 0, 2)).reshape(w, -1)
    out = (columns @ half).reshape(shape[1], shape[0], -1).transpose(1, 0, 2)
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
