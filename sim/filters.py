"""Gaussian filters of arrays of samples, along one axis at a time, as sparse matrices: quicker than a call for each line."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_array


def gaussian(sigma: float, reach: int | None = None) -> np.ndarray:
    """Kernel of sum 1 that ends at `reach`, or four sigmas; in samples."""
    reach = int(np.ceil(4 * sigma)) if reach is None else reach
    g = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-12)) ** 2)
    return g / g.sum()


def derivatives(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Kernels of the first and second derivative, exact on parabolas however small sigma is."""
    g = gaussian(sigma)
    x = np.arange(len(g)) - len(g) // 2
    once, twice = x * g, x**2 * g - (x**2 * g).sum() * g
    return once / (once * x).sum(), 2 * twice / (twice * x**2).sum()


def correlation(n: int, *kernels: np.ndarray) -> csr_array:
    """What correlates n samples with each kernel in turn, shape (kernels * n, n); border values go on beyond the border."""
    return _correlation(n, tuple(tuple(k) for k in kernels))


@lru_cache(64)
def _correlation(n: int, kernels: Sequence[Sequence[float]]) -> csr_array:
    weights, places, lengths = [], [], []
    for kernel in kernels:
        reach = len(kernel) // 2
        places.append(np.clip(np.arange(n)[:, None] + np.arange(-reach, reach + 1), 0, n - 1).ravel())
        weights.append(np.tile(np.array(kernel, np.float32), n))
        lengths.append(np.full(n, len(kernel)))
    starts = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
    return csr_array((np.concatenate(weights), np.concatenate(places), starts), shape=(len(kernels) * n, n))


def smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Values (h, w) smoothed by a Gaussian of three sigmas, float32; sigma in samples."""
    kernel = gaussian(sigma, int(3 * sigma + 0.5))
    along = correlation(values.shape[1], kernel) @ np.ascontiguousarray(values.T, np.float32)
    return correlation(values.shape[0], kernel) @ np.ascontiguousarray(along.T)
