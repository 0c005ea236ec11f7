"""Pentadiagonal lines, open and cyclic: host factors and device solves against SciPy and dense matrices."""

import numpy as np
import pytest
import warp as wp
from scipy.linalg import solve, solveh_banded

from symseek.kernels import integrate
from symseek.sim.solvers.factor import cyclic_bands, factor_cyclic, factor_open, open_bands
from tests import reference
from tests.rig import Rig, array

LINES = 5
sizes = pytest.mark.parametrize("n", [6, 7, 8, 25, 64, 129])


def _rig(n, ns=LINES):
    ns = max(ns, 6)
    return Rig((np.zeros((ns, n, 3)), np.zeros((ns, 3))))


def _solve_rings(bands, rhs):
    """One cyclic line a ring: float64 factors, stored and solved with in float32. rhs (m, n, 3)."""
    m, n, _ = rhs.shape
    factors = factor_cyclic(*bands)
    x = array(rhs.reshape(-1, 3), wp.vec3)
    _rig(n).launch(
        integrate.sweep_rings,
        m,
        factor=array(factors["factor"].reshape(-1, 3), wp.vec3),
        border=array(factors["border"].reshape(-1, 2), wp.vec2),
        corner=array(factors["corner"], wp.vec3),
        delta_out=x,
    )
    return x.numpy().reshape(m, n, 3).astype(float)


def _solve_meridians(bands, rhs):
    """One open line a meridian, entries `m` apart; nothing in the slow modes. rhs (m, n, 3)."""
    m, n, _ = rhs.shape
    rig = _rig(m, n)
    factor = array(np.stack(factor_open(*bands), axis=2).transpose(1, 0, 2).reshape(-1, 3), wp.vec3)
    x = array(rhs.transpose(1, 0, 2).reshape(-1, 3), wp.vec3)
    zero = wp.zeros(4 * n, dtype=wp.vec3, device="cpu")
    rig.launch(integrate.sweep_meridians, rig.model.lines, rings=n, factor=factor, low_factor=zero, delta_out=x)
    return x.numpy().reshape(n, m, 3).transpose(1, 0, 2).astype(float)


def _random_bands(rng, n):
    """Random symmetric lines with a dominant diagonal, so positive definite."""
    first, second = rng.uniform(-1, 1, (2, LINES, n))
    return rng.uniform(4.1, 6, (LINES, n)), first, second


def _dense(bands, j, cyclic):
    """Line j as a matrix; what wraps is dropped where it is open."""
    diagonal, first, second = (b[j] for b in bands)
    n = len(diagonal)
    out = np.diag(diagonal)
    for k in range(n):
        for step, band in ((1, first), (2, second)):
            if cyclic or k + step < n:
                out[k, (k + step) % n] = out[(k + step) % n, k] = band[k]
    return out


@sizes
def test_open_lines_against_scipy(n):
    rng = np.random.default_rng(n)
    bands, rhs = _random_bands(rng, n), rng.normal(size=(LINES, n, 3))
    lower1, lower2, inverse = factor_open(*bands)
    on_device = _solve_meridians(bands, rhs)
    for j in range(LINES):
        upper = np.zeros((3, n))
        upper[0, 2:], upper[1, 1:], upper[2] = bands[2][j, :-2], bands[1][j, :-1], bands[0][j]
        exact = solveh_banded(upper, rhs[j])
        lower = np.eye(n) + np.diag(lower1[j, 1:], -1) + np.diag(lower2[j, 2:], -2)
        np.testing.assert_allclose(lower / inverse[j] @ lower.T, _dense(bands, j, False), atol=1e-13)
        np.testing.assert_allclose(on_device[j], exact, atol=2e-6)


@sizes
def test_cyclic_lines_against_a_dense_solve(n):
    rng = np.random.default_rng(n)
    bands, rhs = _random_bands(rng, n), rng.normal(size=(LINES, n, 3))
    x = _solve_rings(bands, rhs)
    for j in range(LINES):
        exact = np.linalg.solve(_dense(bands, j, cyclic=True), rhs[j])
        np.testing.assert_allclose(x[j], exact, atol=2e-6)


@sizes
@pytest.mark.parametrize("condition", [1e3, 1e7, 1e11])
def test_stiff_lines_keep_four_digits_in_float32(n, condition):
    """1 + dt K of uneven tension and rigidity up to a condition of 1e11, against SciPy: 1e-4, less where lines are short."""
    rng = np.random.default_rng(n)
    tension, rigidity = rng.uniform(0, 1, (LINES, n)), rng.uniform(0.5, 1, (LINES, n))
    rhs = rng.normal(size=(LINES, n, 3))
    for make, on_device, dense, h in (
        (cyclic_bands, _solve_rings, reference.ring_stiffness, 1 / n),
        (open_bands, _solve_meridians, reference.open_stiffness, 1 / (n - 1)),
    ):
        dt = condition * h**4 / 16
        diagonal, first, second = make(tension, rigidity, h)
        x = on_device((1 + dt * diagonal, dt * first, dt * second), rhs)
        for j in range(LINES):
            exact = solve(np.eye(n) + dt * dense(tension[j], rigidity[j]), rhs[j], assume_a="pos")
            assert np.abs(x[j] - exact).max() < min(2e-6 * n, 1e-4) * np.abs(exact).max()


@sizes
def test_bands_are_the_half_hessians_of_2_and_3(n):
    rng = np.random.default_rng(n)
    tension, rigidity = rng.uniform(0, 1, (2, LINES, n))
    for make, dense, h, cyclic in (
        (open_bands, reference.open_stiffness, 1 / (n - 1), False),
        (cyclic_bands, reference.ring_stiffness, 1 / n, True),
    ):
        bands = make(tension, rigidity, h)
        for j in range(LINES):
            exact = dense(tension[j], rigidity[j])
            np.testing.assert_allclose(_dense(bands, j, cyclic), exact, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("factor", [factor_open, factor_cyclic])
def test_indefinite_lines_are_refused(factor):
    """Laplacians with a diagonal below 2: eigenvalues of either sign; one bad line among good ones is enough."""
    diagonal, first, second = np.full((3, 8), 3.0), np.full((3, 8), -1.0), np.zeros((3, 8))
    factor(diagonal, first, second)
    for line, value in ((1, 1.0), (2, -3.0), (0, np.nan)):
        bad = diagonal.copy()
        bad[line] = value
        with pytest.raises(ValueError, match="not positive definite"):
            factor(bad, first, second)


def test_a_ring_indefinite_only_as_a_whole_is_refused():
    """A periodic Laplacian less a little: the open part is definite, the border's Schur complement is not."""
    n = 12
    diagonal, first, second = np.full((1, n), 2.0 - 1e-3), np.full((1, n), -1.0), np.zeros((1, n))
    factor_open(diagonal[:, : n - 2], first[:, : n - 2], second[:, : n - 2])
    with pytest.raises(ValueError, match="ring"):
        factor_cyclic(diagonal, first, second)


def test_a_ring_with_two_negative_directions_is_refused():
    """Both border entries negative: the Schur complement has a positive determinant and is negative all the same."""
    diagonal, first, second = np.full((1, 8), 4.0), np.full((1, 8), -1.0), np.zeros((1, 8))
    diagonal[0, -2:] = -4.0
    assert np.linalg.eigvalsh(_dense((diagonal, first, second), 0, cyclic=True))[1] < 0
    with pytest.raises(ValueError, match="ring"):
        factor_cyclic(diagonal, first, second)
