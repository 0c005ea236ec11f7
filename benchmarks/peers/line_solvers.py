"""Other ways to solve one ADI step (1 + dt Kx)(M + dt Ks) D = dt R on a grid: numba, LAPACK, sparse factors of it all.

Every peer is a class that is made from the bands of Kx and Ks and solves (T, N_s, N_x, 3) in place. Factors are made
once, in float64; all but the sparse one keep and solve in float32, as ours does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse.linalg import splu

from symseek.sim.solvers.base import end_mass
from symseek.sim.solvers.factor import cyclic_bands, factor_cyclic, factor_open, open_bands


@dataclass(frozen=True)
class Step:
    """One elastic step of `tubes` tubes of one grid with open ends and even weights."""

    nx: int
    ns: int
    tubes: int = 1
    dt: float = 0.4
    w20: float = 1e-4
    w02: float = 1e-7

    def around(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bands of 1 + dt Kx, shape (1, N_x) each."""
        w = np.full((1, self.nx), self.w20)
        diagonal, first, second = cyclic_bands(0 * w, w, 1 / self.nx)
        return 1 + self.dt * diagonal, self.dt * first, self.dt * second

    def along(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bands of M + dt Ks, shape (1, N_s) each."""
        w = np.full((1, self.ns), self.w02)
        diagonal, first, second = open_bands(0 * w, w, 1 / (self.ns - 1))
        return end_mass(self.ns) + self.dt * diagonal, self.dt * first, self.dt * second


def _matrix(bands: tuple[np.ndarray, np.ndarray, np.ndarray], cyclic: bool) -> sparse.csc_array:
    """Sparse matrix of one line."""
    diagonal, first, second = (b[0] for b in bands)
    n = len(diagonal)
    i = np.arange(n)
    out = sparse.lil_array((n, n))
    out[i, i] = diagonal
    for k, band in ((1, first), (2, second)):
        rows = i if cyclic else i[:-k]
        out[rows, (rows + k) % n] = band[rows]
        out[(rows + k) % n, rows] = band[rows]
    return out.tocsc()


def _cyclic(step: Step) -> list[np.ndarray]:
    """Factor (1, N_x, 3), border (1, N_x, 2) and corner (1, 3) of the rings."""
    factors = factor_cyclic(*step.around())
    return [factors[name].astype(np.float32) for name in ("factor", "border", "corner")]


def _open(step: Step) -> np.ndarray:
    """Factor (N_s, 3) of the meridians."""
    return np.stack(factor_open(*step.along()), axis=2)[0].astype(np.float32)


class LineByLine:
    """Numba, one thread, float32, a line after the other with factors of its own, all three components at once."""

    def __init__(self, step: Step):
        rows = step.tubes * step.ns
        self.x = [np.repeat(value, rows, axis=0) for value in _cyclic(step)]
        self.s = np.tile(_open(step)[None, :, None], (step.tubes, 1, step.nx, 1))

    def solve(self, v: np.ndarray) -> None:
        _rings(v.reshape(-1, *v.shape[2:]), *self.x)
        _meridians(v, self.s)


class Interleaved:
    """Numba, one thread, float32, vectorised across tubes, whose values lie side by side: (N_x, N_s, 3, T)."""

    def __init__(self, step: Step):
        self.x = [np.repeat(value[0][..., None], step.tubes, axis=-1) for value in _cyclic(step)]
        self.s = np.repeat(_open(step)[..., None], step.tubes, axis=-1)

    def solve(self, v: np.ndarray) -> None:
        """As the others, but `v` has shape (N_x, N_s, 3, T)."""
        _rings_across(v, *self.x)
        _meridians_across(v, self.s)


class Lapack:
    """LAPACK's pbtrs with factors made once: one call for all rings, which share a factor, one for all meridians."""

    def __init__(self, step: Step):
        self.around = self._factor(step.around(), step.nx - 2)
        self.along = self._factor(step.along(), step.ns)
        _, border, corner = _cyclic(step)
        a, b, c = corner[0]
        self.border, self.corner = border[0, :-2], np.array([[a, b], [b, c]])

    @staticmethod
    def _factor(bands: tuple[np.ndarray, np.ndarray, np.ndarray], n: int) -> np.ndarray:
        factor, status = lapack.dpbtrf(np.stack([b[0, :n] for b in bands]), lower=1)
        assert status == 0
        return np.asfortranarray(factor, np.float32)

    def solve(self, v: np.ndarray) -> None:
        tubes, ns, nx, _ = v.shape
        r = np.asfortranarray(v.transpose(2, 0, 1, 3).reshape(nx, -1))
        ends = self.corner @ (r[-2:] - self.border.T @ r[:-2])
        y, _ = lapack.spbtrs(self.around, r[:-2], lower=1)
        half = np.concatenate([y - self.border @ ends, ends]).reshape(nx, tubes, ns, 3)
        r = np.asfortranarray(half.transpose(2, 1, 0, 3).reshape(ns, -1))
        y, _ = lapack.spbtrs(self.along, r, lower=1, overwrite_b=1)
        v[:] = y.reshape(ns, tubes, nx, 3).transpose(1, 0, 2, 3)


class SparseFactors:
    """SciPy's splu of the whole step (M + dt K) D = dt R, which no splitting approximates, in float64."""

    def __init__(self, step: Step):
        mass = sparse.diags_array(end_mass(step.ns))
        around = _matrix(step.around(), cyclic=True) - sparse.eye_array(step.nx)
        whole = sparse.kron(_matrix(step.along(), cyclic=False), sparse.eye_array(step.nx)) + sparse.kron(mass, around)
        self.factor = splu(whole.tocsc())  # its default ordering, COLAMD, fills least here

    def solve(self, v: np.ndarray) -> None:
        tubes, ns, nx, _ = v.shape
        r = v.reshape(tubes, ns * nx, 3).transpose(1, 0, 2).reshape(ns * nx, -1).astype(float)
        v[:] = self.factor.solve(r).reshape(ns, nx, tubes, 3).transpose(2, 0, 1, 3)


@numba.njit(fastmath=True, cache=True)
def _rings(v, factor, border, corner):
    rows, n = v.shape[:2]
    m = n - 2
    for r in range(rows):
        x, f, w = v[r], factor[r], border[r]
        p0 = p1 = p2 = q0 = q1 = q2 = np.float32(0)
        s0, s1, s2 = x[m]
        t0, t1, t2 = x[m + 1]
        for i in range(m):
            y0, y1, y2 = x[i, 0], x[i, 1], x[i, 2]
            c, d = w[i, 0], w[i, 1]
            s0, s1, s2 = s0 - c * y0, s1 - c * y1, s2 - c * y2
            t0, t1, t2 = t0 - d * y0, t1 - d * y1, t2 - d * y2
            c, d = f[i, 0], f[i, 1]
            y0, y1, y2 = y0 - c * p0 - d * q0, y1 - c * p1 - d * q1, y2 - c * p2 - d * q2
            x[i, 0], x[i, 1], x[i, 2] = y0, y1, y2
            q0, q1, q2, p0, p1, p2 = p0, p1, p2, y0, y1, y2
        a, b, e = corner[r]
        s0, t0 = a * s0 + b * t0, b * s0 + e * t0
        s1, t1 = a * s1 + b * t1, b * s1 + e * t1
        s2, t2 = a * s2 + b * t2, b * s2 + e * t2
        x[m, 0], x[m, 1], x[m, 2] = s0, s1, s2
        x[m + 1, 0], x[m + 1, 1], x[m + 1, 2] = t0, t1, t2
        p0 = p1 = p2 = q0 = q1 = q2 = a = b = e = np.float32(0)
        for i in range(m - 1, -1, -1):
            g, c, d = f[i, 2], w[i, 0], w[i, 1]
            y0 = x[i, 0] * g - a * p0 - b * q0
            y1 = x[i, 1] * g - a * p1 - b * q1
            y2 = x[i, 2] * g - a * p2 - b * q2
            x[i, 0], x[i, 1], x[i, 2] = y0 - c * s0 - d * t0, y1 - c * s1 - d * t1, y2 - c * s2 - d * t2
            q0, q1, q2, p0, p1, p2 = p0, p1, p2, y0, y1, y2
            a, b, e = f[i, 0], e, f[i, 1]


@numba.njit(fastmath=True, cache=True)
def _meridians(v, factor):
    tubes, n, lines = v.shape[:3]
    for k in range(tubes):
        for x in range(lines):
            p0 = p1 = p2 = q0 = q1 = q2 = np.float32(0)
            for i in range(n):
                a, b = factor[k, i, x, 0], factor[k, i, x, 1]
                y0 = v[k, i, x, 0] - a * p0 - b * q0
                y1 = v[k, i, x, 1] - a * p1 - b * q1
                y2 = v[k, i, x, 2] - a * p2 - b * q2
                v[k, i, x, 0], v[k, i, x, 1], v[k, i, x, 2] = y0, y1, y2
                q0, q1, q2, p0, p1, p2 = p0, p1, p2, y0, y1, y2
            p0 = p1 = p2 = q0 = q1 = q2 = a = b = c = np.float32(0)
            for i in range(n - 1, -1, -1):
                d = factor[k, i, x, 2]
                y0 = v[k, i, x, 0] * d - a * p0 - b * q0
                y1 = v[k, i, x, 1] * d - a * p1 - b * q1
                y2 = v[k, i, x, 2] * d - a * p2 - b * q2
                v[k, i, x, 0], v[k, i, x, 1], v[k, i, x, 2] = y0, y1, y2
                q0, q1, q2, p0, p1, p2 = p0, p1, p2, y0, y1, y2
                a, b, c = factor[k, i, x, 0], c, factor[k, i, x, 1]


@numba.njit(fastmath=True, cache=True)
def _rings_across(v, factor, border, corner):
    n, rows, _, tubes = v.shape
    m = n - 2
    first, last = np.empty((2, tubes), np.float32)
    for r in range(rows):
        for c in range(3):
            first[:] = v[m, r, c]
            last[:] = v[m + 1, r, c]
            for i in range(m):
                for t in range(tubes):
                    y = v[i, r, c, t]
                    first[t] -= border[i, 0, t] * y
                    last[t] -= border[i, 1, t] * y
                if i > 0:
                    for t in range(tubes):
                        v[i, r, c, t] -= factor[i, 0, t] * v[i - 1, r, c, t]
                if i > 1:
                    for t in range(tubes):
                        v[i, r, c, t] -= factor[i, 1, t] * v[i - 2, r, c, t]
            for t in range(tubes):
                a = corner[0, t] * first[t] + corner[1, t] * last[t]
                b = corner[1, t] * first[t] + corner[2, t] * last[t]
                v[m, r, c, t] = a
                v[m + 1, r, c, t] = b
            for i in range(m - 1, -1, -1):
                for t in range(tubes):
                    v[i, r, c, t] *= factor[i, 2, t]
                if i < m - 1:
                    for t in range(tubes):
                        v[i, r, c, t] -= factor[i + 1, 0, t] * v[i + 1, r, c, t]
                if i < m - 2:
                    for t in range(tubes):
                        v[i, r, c, t] -= factor[i + 2, 1, t] * v[i + 2, r, c, t]
            for i in range(m):
                for t in range(tubes):
                    v[i, r, c, t] -= border[i, 0, t] * v[m, r, c, t] + border[i, 1, t] * v[m + 1, r, c, t]


@numba.njit(fastmath=True, cache=True)
def _meridians_across(v, factor):
    lines, n, _, tubes = v.shape
    for x in range(lines):
        for i in range(1, n):
            for c in range(3):
                for t in range(tubes):
                    v[x, i, c, t] -= factor[i, 0, t] * v[x, i - 1, c, t]
                if i > 1:
                    for t in range(tubes):
                        v[x, i, c, t] -= factor[i, 1, t] * v[x, i - 2, c, t]
        for i in range(n - 1, -1, -1):
            for c in range(3):
                for t in range(tubes):
                    v[x, i, c, t] *= factor[i, 2, t]
                if i < n - 1:
                    for t in range(tubes):
                        v[x, i, c, t] -= factor[i + 1, 0, t] * v[x, i + 1, c, t]
                if i < n - 2:
                    for t in range(tubes):
                        v[x, i, c, t] -= factor[i + 2, 1, t] * v[x, i + 2, c, t]
