"""Elastic forces of line, ring and sheet: (4), (5) against differences of the energies (2), (3) and closed forms."""

from typing import Any

import numpy as np
import pytest

from symseek.kernels import elastic
from symseek.sim.solvers import make_solver
from tests import reference
from tests.rig import EPS, Rig, circles, even_spine

RNG = np.random.default_rng(1)
NX, NS = 7, 9
HX, HS = 1 / NX, 1 / (NS - 1)
WEIGHTS = ("w10", "w20", "w11", "w01", "w02")
TUBE = RNG.normal(size=(NS, NX, 3)).astype(np.float32).astype(float)
SPINE = (even_spine(NS) + 0.1 * RNG.normal(size=(NS, 3))).astype(np.float32).astype(float)


def _uneven(shape):
    """Weights in 0.2 .. 1, a quarter of them zero."""
    values = RNG.uniform(0.2, 1, shape)
    values[RNG.uniform(size=shape) < 0.25] = 0.0
    return values.astype(np.float32).astype(float)


def _rounding(tension: float, rigidity: float, size: float) -> float:
    """Float32's rounding of D' w D v: row sums 4 / h^2 and 16 / h^4."""
    return 4 * EPS * (4 * tension + 16 * rigidity) * size


@pytest.mark.parametrize("name", [*WEIGHTS, "all"])
def test_tube_force_is_half_the_gradient_of_3(name):
    weights = {w: _uneven((NS, NX)) if name in (w, "all") else np.zeros((NS, NX)) for w in WEIGHTS}
    flat: dict[str, Any] = {w: a.ravel() for w, a in weights.items()}
    force, _ = Rig((TUBE, SPINE), **flat).forces()
    gradient = reference.gradient(lambda v: reference.tube_energy(v, **weights), TUBE, 1e-2)
    rows = {"w10": 4 / HX**2, "w20": 16 / HX**4, "w11": 32 / (HX * HS) ** 2, "w01": 4 / HS**2, "w02": 16 / HS**4}
    atol = 2 * EPS * np.abs(TUBE).max() * rows.get(name, sum(rows.values()))
    np.testing.assert_allclose(force, -0.5 * gradient / (HX * HS), rtol=0, atol=atol)
    assert np.abs(force).max() > 1e3 * atol


def test_spine_force_is_half_the_gradient_of_2():
    w1, w2 = _uneven(NS), _uneven(NS)
    rig = Rig((TUBE, SPINE), w1=w1, w2=w2)
    rig.model.bend_basis.zero_()  # no natural curvature: the plain (2)
    gradient = reference.gradient(lambda v: reference.spine_energy(v, w1, w2), SPINE, 1e-2)
    atol = _rounding(1 / HS**2, 1 / HS**4, 1.0)
    np.testing.assert_allclose(rig.forces()[1], -0.5 * gradient / HS, rtol=0, atol=atol)


def test_spine_resists_only_what_a_cubic_bend_leaves():
    _, force = Rig((TUBE, SPINE), w2=0.5).forces()
    gradient = reference.gradient(lambda v: reference.bend_beyond_cubic(v, 0.5), SPINE, 1e-2)
    atol = _rounding(0, 0.5 / HS**4, 1.0)
    np.testing.assert_allclose(force, -0.5 * gradient / HS, rtol=0, atol=atol)
    s = np.linspace(-1, 1, NS)
    banana = np.stack([s**5 - s**2, s + 0.2 * s**4, 0.3 * s**3], -1)  # second differences are cubic in s
    _, force = Rig((TUBE, banana), w2=0.5).forces()
    np.testing.assert_allclose(force, 0, atol=atol)


def test_moving_or_turning_the_whole_changes_nothing():
    """No net force, no net torque, and the same forces after a shift that float32 holds exactly."""
    tube, spine = np.round(TUBE * 256) / 256, np.round(SPINE * 256) / 256
    weights = {w: _uneven(NS * NX) for w in WEIGHTS} | {"w1": _uneven(NS), "w2": 0.5}
    force, spine_force = Rig((tube, spine), **weights).forces()
    shift = np.array([1.0, -2.0, 4.0])
    moved, spine_moved = Rig((tube + shift, spine + shift), **weights).forces()
    atol = _rounding(2 / HX**2, 4 / HX**4, 8.0)
    np.testing.assert_allclose(moved, force, rtol=0, atol=atol)
    np.testing.assert_allclose(spine_moved, spine_force, rtol=0, atol=atol)
    for f, at in ((force, tube), (spine_force, spine)):
        np.testing.assert_allclose(f.reshape(-1, 3).sum(0), 0, atol=atol)
        np.testing.assert_allclose(np.cross(at, f).reshape(-1, 3).sum(0), 0, atol=4 * atol)


def test_straight_even_lines_have_no_force():
    tube = circles(even_spine(NS), 0.25, NX)
    force, spine_force = Rig((tube, even_spine(NS)), w01=1.0, w02=1.0, w11=1.0, w1=1.0, w2=1.0, k1=1.0).forces()
    inner = slice(1, -1)  # tension pulls at the ends alone
    np.testing.assert_allclose(force[inner], 0, atol=_rounding(1 / HS**2, 2 / HS**4, 1.0))
    np.testing.assert_allclose(spine_force[inner], 0, atol=_rounding(1 / HS**2, 2 / HS**4, 1.0))
    np.testing.assert_allclose(spine_force[0], [0, 1 / HS, 0], atol=_rounding(1 / HS**2, 2 / HS**4, 1.0))


def test_a_circle_contracts_by_its_closed_form():
    """w10 and w20 on a regular polygon of radius R: -(w10 L + w20 L^2) R, L = (2 n sin(pi / n))^2."""
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    spine = even_spine(NS)
    tube = circles(spine, 0.25, NX)
    force, _ = Rig((tube, spine), w10=0.5, w20=0.01).forces()
    expected = -(0.5 * lap + 0.01 * lap**2) * reference.end_mass(NS)[:, None, None] * (tube - spine[:, None])
    np.testing.assert_allclose(force, expected, atol=_rounding(0.5 / HX**2, 0.01 / HX**4, 1.0))


def test_short_edges_of_the_spine_push():
    """-K1 (length along the tangent - least)^2 / 2h^2 below the least length, tangent and least held; else nothing."""
    spine = even_spine(NS)
    spine[4] = spine[5] + [0.05, 0.02, 0]  # a node that passed the next one
    k1 = 0.3
    rig = Rig((circles(even_spine(NS), 0.25, NX), spine), k1=k1)
    _, force = rig.forces()
    tangent = rig.state.tangent.numpy().astype(float)
    along = tangent[:-1] + tangent[1:]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    least = elastic.CLOSEST * np.linalg.norm(np.diff(spine, axis=0), axis=1).mean()

    def energy(v):
        lack = np.minimum(np.sum(np.diff(v, axis=0) * along, axis=1) - least, 0)
        return 0.5 * k1 / HS**2 * np.sum(lack**2)

    np.testing.assert_allclose(force, -reference.gradient(energy, spine, 1e-6), atol=1e-5)
    assert np.linalg.norm(force[4]) > 0.1 and np.abs(force[[0, 1, 7, 8]]).max() == 0


def test_tubes_do_not_feel_each_other():
    other, other_spine = RNG.normal(size=(6, 8, 3)), RNG.normal(size=(6, 3))
    weights = {"w10": 0.1, "w20": 0.2, "w11": 0.3, "w01": 0.4, "w02": 0.5, "w1": 0.6, "w2": 0.7, "k1": 1.0}
    weights |= {"a": 1.0, "reaction": 0.5, "b": 1.0, "c": 0.1, "balance": 1.0, "free": 0.7, "d": 0.2, "centre": 0.5}
    for closed in (False, True):
        both = Rig((TUBE, SPINE), (other, other_spine), closed=closed, **weights)
        first, spine_forces = both.forces()
        second = both.state.force.numpy()[NX * NS :].reshape(6, 8, 3)
        alone, spine_alone = Rig((TUBE, SPINE), closed=closed, **weights).forces()
        other_alone, other_spine_alone = Rig((other, other_spine), closed=closed, **weights).forces()
        np.testing.assert_array_equal(first, alone)
        np.testing.assert_array_equal(second, other_alone)
        np.testing.assert_array_equal(spine_forces, np.concatenate([spine_alone, other_spine_alone]))


@pytest.mark.parametrize(("name", "sizes"), [("tension", (17, 33, 65, 129)), ("rigidity", (9, 13, 17, 25, 33))])
def test_force_converges_to_4(name, sizes):
    """d/ds(w1 dv/ds) and -d2/ds2(w2 d2v/ds2) of v = sin(2 pi s), w = 1 + s: second order at nodes off the ends."""
    errors = []
    for n in sizes:
        s = np.linspace(0, 1, n)
        k = 2 * np.pi
        line = np.zeros((n, NX, 3))
        line[..., 0] = np.sin(k * s)[:, None]
        edge = s + 0.5 / (n - 1)
        weights: dict[str, Any]
        if name == "tension":
            weights = {"w01": np.repeat(1 + edge, NX)}
            exact = k * np.cos(k * s) - (1 + s) * k**2 * np.sin(k * s)
        else:
            weights = {"w02": np.repeat(1 + s, NX)}
            exact = 2 * k**3 * np.cos(k * s) - (1 + s) * k**4 * np.sin(k * s)
        force, _ = Rig((line, even_spine(n)), **weights).forces()
        errors.append(np.sqrt(np.mean((force[2:-2, 0, 0] - exact[2:-2]) ** 2)))
    assert reference.slope(sizes, errors) >= 1.8


def test_equilibrium_of_a_spline_converges():
    """A spine with (2) on soft springs a to its rings, a v + w2 v'''' = a c, natural ends: second order.

    v = s^2 (1 - s)^2 integrated twice has v'' = v''' = 0 at both ends; c follows from it.
    """
    bend = np.polynomial.Polynomial([0, 0, 1, -2, 1]) * 8.0
    shape, w2, a = bend.integ(2), 3e-3, 1.0
    target = shape + (w2 / a) * bend.deriv(2)
    sizes, errors = (17, 33, 65, 129), []
    for n in sizes:
        s = np.linspace(0, 1, n)
        centres = even_spine(n) + target(s)[:, None] * np.array([1.0, 0, 0])
        rig = Rig((circles(centres, 0.1, 6), even_spine(n)), a=a, w2=w2)
        rig.model.bend_basis.zero_()
        solver = make_solver("adi", rig.model, 1.0, 6.0, 0.0)
        for _ in range(60):
            rig.forces()
            solver.step(rig.state)
        errors.append(np.abs(rig.spine()[:, 0] - shape(s)).max())
    assert reference.slope(sizes, errors) >= 1.8
    assert errors[-1] < 1e-4
