"""Pentadiagonal factors, made on the host in float64 and kept in float32 (section 5: only when material changes)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded


def factor_open(diagonal: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """L D L^T of m symmetric pentadiagonal lines.

    Args:
        diagonal: shape (m, n).
        first: shape (m, n), entry k couples k and k + 1; the last is unused.
        second: shape (m, n), entry k couples k and k + 2; the last two are unused.

    Returns:
        lower1, lower2, inverse: shape (m, n); entry k belongs to row k of L and to 1 / D.

    Raises:
        ValueError: a line is not positive definite.
    """
    return _unit(_cholesky(diagonal, first, second), diagonal.shape)


def _cholesky(diagonal: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """LAPACK's lower Cholesky bands of all lines one after the other, which nothing couples, shape (3, m n)."""
    bands = np.stack([diagonal, first, second])
    bands[1, :, -1:] = bands[2, :, -2:] = 0.0
    try:
        found = cholesky_banded(bands.reshape(3, -1), lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        found = np.zeros(1)
    if not np.all(found[0] > 0):
        raise ValueError("a line's matrix is not positive definite: weights must not be negative")
    return found


def _unit(cholesky: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same as `factor_open` returns it."""
    root, below1, below2 = cholesky.reshape(3, *shape)
    lower1, lower2 = np.zeros(shape), np.zeros(shape)
    lower1[:, 1:], lower2[:, 2:] = below1[:, :-1] / root[:, :-1], below2[:, :-2] / root[:, :-2]
    return lower1, lower2, 1 / root**2


def factor_cyclic(diagonal: np.ndarray, first: np.ndarray, second: np.ndarray) -> dict[str, np.ndarray]:
    """Bordered factors of m cyclic pentadiagonal lines of n >= 6 unknowns, for `kernels.banded.solve_cyclic`.

    Arguments as in `factor_open`, with every entry used (indices wrap).

    Returns:
        factor (m, n, 3; last two rows 0), border (m, n, 2; likewise), corner (m, 3).
    """
    m, n = diagonal.shape
    k = n - 2
    inner = _cholesky(diagonal[:, :k], first[:, :k], second[:, :k])
    c = np.zeros((2, m, k))
    c[0, :, 0], c[0, :, k - 2], c[0, :, k - 1] = second[:, k], second[:, k - 2], first[:, k - 1]
    c[1, :, 0], c[1, :, 1], c[1, :, k - 1] = first[:, n - 1], second[:, n - 1], second[:, k - 1]
    w = cho_solve_banded((inner, True), c.reshape(2, -1).T, check_finite=False).T.reshape(c.shape)
    s00 = diagonal[:, k] - np.sum(c[0] * w[0], axis=1)
    s01 = first[:, k] - np.sum(c[0] * w[1], axis=1)
    s11 = diagonal[:, k + 1] - np.sum(c[1] * w[1], axis=1)
    det = s00 * s11 - s01**2
    if not np.all((det > 0) & (s00 > 0)):
        raise ValueError("a ring's matrix is not positive definite: weights must not be negative")
    pad = ((0, 0), (0, 2), (0, 0))
    border = np.pad(np.moveaxis(w, 0, 2), pad)
    return {
        "factor": np.pad(np.stack(_unit(inner, (m, k)), axis=2), pad),
        # values that decayed into denormals cost time and carry nothing
        "border": np.where(np.abs(border) < 1e-20, 0.0, border),
        "corner": np.stack([s11 / det, -s01 / det, s00 / det], axis=1),
    }


def open_bands(tension: np.ndarray, rigidity: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bands of the stiffness D1' w1 D1 / h^2 + D2' w2 D2 / h^4 of open lines with natural ends, (4).

    Args:
        tension: of the edge from k to k + 1, shape (m, n).
        rigidity: of node k, shape (m, n).
        h: spacing of the material coordinate.

    Returns:
        diagonal, first, second as `factor_open` takes them.
    """
    t = tension / h**2
    w = rigidity / h**4
    t[:, -1] = 0.0
    w[:, 0] = w[:, -1] = 0.0
    diagonal = t + 4 * w
    diagonal[:, 1:] += t[:, :-1] + w[:, :-1]
    diagonal[:, :-1] += w[:, 1:]
    first = -t - 2 * w
    first[:, :-1] -= 2 * w[:, 1:]
    first[:, -1] = 0.0
    second = np.zeros_like(t)
    second[:, :-2] = w[:, 1:-1]
    return diagonal, first, second


def cyclic_bands(tension: np.ndarray, rigidity: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bands of the same stiffness on periodic lines (6), every entry used."""
    t = tension / h**2
    w = rigidity / h**4
    after = np.roll(w, -1, axis=1)
    diagonal = t + np.roll(t, 1, axis=1) + 4 * w + np.roll(w, 1, axis=1) + after
    return diagonal, -t - 2 * w - 2 * after, after
