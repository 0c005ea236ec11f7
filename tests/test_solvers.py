"""One step of each scheme against dense matrices, stability of Euler's bound, and one equilibrium for all."""

import re
from typing import Any

import numpy as np
import pytest

from symseek.sim.solvers import SCHEMES, make_solver
from tests import reference
from tests.rig import Rig, circles, even_spine

NX, NS, DT, SLOW = 8, 7, 0.4, 3.0
STEPS = {"adi": (DT, SLOW), "jacobi": (DT, SLOW), "euler": (0.1, 1.0), "sor": (DT, 1.0), "direct": (DT, SLOW)}
MASS = reference.end_mass(NS)
B = np.linspace(0.5, 1.5, NS)
schemes = pytest.mark.parametrize("scheme", SCHEMES)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def weights(rng):
    """Uneven weights of a tube, (ns, nx), stiff enough to matter and soft enough for Euler."""
    scale = {"w10": 1e-2, "w20": 1e-4, "w01": 1e-2, "w02": 3e-4}
    return {w: (k * rng.uniform(0.2, 1, (NS, NX))).astype(np.float32).astype(float) for w, k in scale.items()}


def _rig(weights, closed=False, **more):
    radius = np.full(NS, 0.2)
    if closed:
        radius[[0, -1]] = 0
    tube = circles(even_spine(NS), radius, NX)
    return Rig((tube, even_spine(NS)), closed=closed, b=B, **{w: a.ravel() for w, a in weights.items()}, **more)


def _fast(force):
    """What a force has beyond the modes 0 and +-1 of each ring."""
    spectrum = np.fft.fft(force, axis=1)
    spectrum[:, [0, 1, -1]] = 0
    return np.fft.ifft(spectrum, axis=1).real


def _moved(rig, scheme, force, spine_force=None, momentum=0.0, steps=1):
    """How far tube and spine go under given forces."""
    solver = make_solver(scheme, rig.model, *STEPS[scheme], momentum)
    rig.forces()
    tube, spine = rig.tube(), rig.spine()
    rig.state.force.assign(force.reshape(-1, 3).astype(np.float32))
    rig.state.spine_force.assign((0 * spine if spine_force is None else spine_force).astype(np.float32))
    for _ in range(steps):
        solver.step(rig.state)
    return rig.tube() - tube, rig.spine() - spine


def _rings(weights):
    return [reference.ring_stiffness(weights["w10"][s], weights["w20"][s]) for s in range(NS)]


def _meridians(weights):
    return [reference.open_stiffness(weights["w01"][:, x], weights["w02"][:, x]) for x in range(NX)]


@pytest.mark.parametrize("closed", [False, True])
def test_adi_is_two_dense_solves(rng, weights, closed):
    """(1 + dt (Kx + b)) and then (M + dt Ks) on what a ring has beyond its slow modes; closed ends stay."""
    force = _fast(rng.normal(size=(NS, NX, 3)))
    moved, _ = _moved(_rig(weights, closed), "adi", force)
    half = np.stack([np.linalg.solve(np.eye(NX) * (1 + DT * b) + DT * k, DT * f)
                     for b, k, f in zip(B, _rings(weights), force, strict=True)])  # fmt: skip
    expected = np.zeros_like(force)
    free = slice(1, -1) if closed else slice(None)
    for x, k in enumerate(_meridians(weights)):
        expected[free, x] = np.linalg.solve((np.diag(MASS) + DT * k)[free, free], half[free, x])
    np.testing.assert_allclose(moved, expected, atol=2e-6)


def test_adi_moves_rings_and_spine_as_lines(rng, weights):
    """Modes 0 and +-1 take the longer step: lines of weights bound around, with the ties to spine and depth implicit."""
    mean, tilt, spine_force = rng.normal(size=(3, NS, 3))
    rig = _rig(weights, reaction=0.3, depth=0.2, d=0.4, a=0.7, w1=2e-2, w2=1e-3, k1=0.05)
    solver = make_solver("adi", rig.model, DT, SLOW, 0.0)
    wave = np.cos(2 * np.pi * np.arange(NX) / NX)
    force = mean[:, None] + tilt[:, None] * wave[:, None]
    moved, spine_moved = _moved(rig, "adi", force, spine_force)
    bound = {w: np.minimum(2 * a.mean(1), a.max(1)) for w, a in weights.items()}  # w (cos)^2 has at most twice the mean
    along = reference.open_stiffness(bound["w01"], bound["w02"])
    step = DT * SLOW
    place = np.linalg.solve(np.diag(MASS * (1 + step * (0.3 + 0.5 * B + 0.2))) + step * along, step * mean)
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    first = bound["w10"] * lap + bound["w20"] * lap**2 + 0.5 * B + 0.4
    turn = np.linalg.solve(np.diag(MASS) + step * along, step / (1 + step * first)[:, None] * tilt)
    np.testing.assert_allclose(moved, place[:, None] + turn[:, None] * wave[:, None], atol=1e-5)
    spine = reference.open_stiffness(np.full(NS, 2e-2 + 0.05), np.full(NS, 1e-3))
    own = solver.spine_dt
    expected = np.linalg.solve(np.diag(MASS * (1 + own * 0.7)) + own * spine, own * spine_force)
    np.testing.assert_allclose(spine_moved, expected, atol=1e-5)


def test_jacobi_divides_by_the_sum_of_a_row(rng, weights):
    """dt R / (M (1 + dt / 2 sum |K|))."""
    force = _fast(rng.normal(size=(NS, NX, 3)))
    moved, _ = _moved(_rig(weights), "jacobi", force)
    around = np.stack([np.abs(k).sum(1) for k in _rings(weights)])
    along = np.stack([np.abs(k).sum(1) for k in _meridians(weights)], -1) / MASS[:, None]
    whole = around + along + B[:, None]
    np.testing.assert_allclose(moved, DT * force / (MASS[:, None] * (1 + 0.5 * DT * whole))[..., None], atol=1e-6)


def test_euler_is_dt_r(rng, weights):
    force = _fast(rng.normal(size=(NS, NX, 3)))
    moved, _ = _moved(_rig(weights), "euler", force)
    np.testing.assert_allclose(moved, STEPS["euler"][0] * force / MASS[:, None, None], atol=1e-6)


@schemes
def test_momentum_repeats_a_share_of_each_step(rng, weights, scheme):
    """A steady force d: d, then (1 + m) d, then (1 + m + m^2) d."""
    force, spine_force = rng.normal(size=(NS, NX, 3)), rng.normal(size=(NS, 3))
    once = _moved(_rig(weights, a=0.1), scheme, force, spine_force)
    thrice = _moved(_rig(weights, a=0.1), scheme, force, spine_force, momentum=0.3, steps=3)
    for first, third in zip(once, thrice, strict=True):
        np.testing.assert_allclose(third, (1 + 1.3 + 1.39) * first, atol=2e-5)


@schemes
def test_momentum_grows_and_starts_anew_against_the_force(rng, weights, scheme):
    """Steps d and (1 + 2/5) d; then, the force turned round, -d without momentum."""
    rig, force = _rig(weights), rng.normal(size=(NS, NX, 3))
    tube = rig.tube()
    solver = make_solver(scheme, rig.model, *STEPS[scheme], 0.9)
    rig.forces()
    places = []
    for sign in (1, 1, -1):
        rig.state.force.assign(sign * force.reshape(-1, 3).astype(np.float32))
        rig.state.spine_force.zero_()
        solver.step(rig.state)
        places.append(rig.tube() - tube)
    first = places[0]
    np.testing.assert_allclose(places[1], (1 + 1.4) * first, atol=2e-5)
    np.testing.assert_allclose(places[2], 1.4 * first, atol=2e-5)
    assert rig.state.momentum.numpy() == 0


@schemes
def test_closed_ends_move_as_one_and_nothing_moves_at_rest(rng, weights, scheme):
    force = rng.normal(size=(NS, NX, 3))
    moved, _ = _moved(_rig(weights, closed=True, a=0.1), scheme, force)
    np.testing.assert_allclose(np.ptp(moved[[0, -1]], axis=1), 0, atol=1e-6)
    assert np.sum(moved[0, 0] * force[0].mean(0)) > 0
    rig = _rig(weights, closed=True, a=0.1)
    moved, spine_moved = _moved(rig, scheme, 0 * force)
    assert not moved.any() and not spine_moved.any() and not rig.state.residual.numpy().any()


def test_residual_is_that_of_place_and_radius(rng, weights):
    """g + p r / |r| on circles: g^2 + p^2 for each ring, whatever is added in higher modes; at closed ends g^2."""
    push, pressure = rng.normal(size=(NS, 3)), rng.normal(size=NS)
    outward = circles(np.zeros((NS, 3)), 1.0, NX)
    wave = np.cos(6 * np.pi * np.arange(NX) / NX)[:, None] * np.array([0, 1.0, 0])
    force = push[:, None] + pressure[:, None, None] * outward + wave
    for closed in (False, True):
        rig = _rig(weights, closed=closed)
        _moved(rig, "adi", force)
        expected = np.sum(push**2, axis=1) + pressure**2
        if closed:
            expected[[0, -1]] -= pressure[[0, -1]] ** 2
        np.testing.assert_allclose(rig.state.residual.numpy(), expected, rtol=1e-5)


@schemes
def test_changed_material_makes_new_factors(rng, weights, scheme):
    rig, force = _rig(weights, w1=0.01, w2=1e-4), rng.normal(size=(NS, NX, 3))
    fresh = _moved(_rig({w: 0.5 * a for w, a in weights.items()}, w1=0.01, w2=1e-4), scheme, force, force[:, 0])
    solver = make_solver(scheme, rig.model, *STEPS[scheme], 0.0)
    for w in weights:
        getattr(rig.model, w).assign(0.5 * getattr(rig.model, w).numpy())
    solver.material_changed()
    rig.forces()
    tube = rig.tube()
    rig.state.force.assign(force.reshape(-1, 3).astype(np.float32))
    rig.state.spine_force.assign(force[:, 0].astype(np.float32))
    solver.step(rig.state)
    np.testing.assert_allclose(rig.tube() - tube, fresh[0], atol=1e-6)


@schemes
def test_tubes_step_apart(rng, scheme):
    """Two tubes of different grids go where each goes alone."""
    pairs = [(rng.normal(size=(ns, nx, 3)), rng.normal(size=(ns, 3))) for nx, ns in ((8, 7), (10, 9))]
    weights: dict[str, Any] = {
        "w10": 0.01,
        "w20": 1e-4,
        "w01": 1e-3,
        "w02": 1e-5,
        "w1": 1e-3,
        "w2": 1e-5,
        "a": 1.0,
        "b": 1.0,
    }

    def after(*some):
        rig = Rig(*some, **weights)
        solver = make_solver(scheme, rig.model, 0.05, 2.0, 0.5)
        for _ in range(3):
            rig.forces()
            solver.step(rig.state)
        return rig.state.tube.numpy()

    np.testing.assert_allclose(after(*pairs), np.concatenate([after(p) for p in pairs]), atol=1e-6)


def _runs(rig, rng, step, slow):
    """Euler at a step from a rough start: whether it stays bounded."""
    solver = make_solver("euler", rig.model, step, slow, 0.0)
    rig.state.tube.assign(rig.state.tube.numpy() + 1e-2 * rng.normal(size=(NS * NX, 3)).astype(np.float32))
    for _ in range(300):
        rig.forces()
        solver.step(rig.state)
    return max(np.abs(rig.tube()).max(), np.abs(rig.spine()).max()) < 2


@pytest.mark.parametrize(("stiff", "spine", "slow"), [(20, {"w2": 1e-3}, 1.0), (20, {}, 1.0), (0.1, {"a": 1.0}, 3.0)])
def test_euler_refuses_too_long_a_step_and_bears_the_one_it_names(rng, weights, stiff, spine, slow):
    """Stiff is the tube; the tube round a spine without any stiffness; the spine's tie to its rings."""
    weights = {w: stiff * a for w, a in weights.items()}
    rig = _rig(weights, **spine)
    with pytest.raises(ValueError, match=r"2 is too long for explicit Euler") as error:
        make_solver("euler", rig.model, 2.0, slow, 0.0)
    found = re.search(r"at most ([\d.e-]+);.*adi", str(error.value))
    assert found, str(error.value)
    assert _runs(rig, rng, 0.99 * float(found[1]), slow)  # the message rounds to three digits


def test_euler_finds_a_step_of_its_own(rng, weights):
    """Without one given it takes one that it bears, and a shorter one once the material is stiffer."""
    rig = _rig(weights, a=1.0, w2=1e-3)
    solver = make_solver("euler", rig.model, None, None, 0.0)
    first = solver.dt
    rig.model.w20.assign(30 * rig.model.w20.numpy())
    solver.material_changed()
    assert 0 < solver.dt < first
    assert _runs(rig, rng, None, None)


def test_eulers_bound_is_no_smaller_than_need_be(weights):
    """Within 2 / (largest eigenvalue of M^-1 K), and at least a third of that."""
    rig = _rig({w: 20 * a for w, a in weights.items()}, w2=1e-6)
    with pytest.raises(ValueError, match="at most") as error:
        make_solver("euler", rig.model, 2.0, 1.0, 0.0)
    step = float(str(error.value).split("at most ")[1].split(";")[0])
    stiffness = np.zeros((NS, NX, NS, NX))
    for s, k in enumerate(_rings(weights)):
        stiffness[s, :, s] += 20 * k
    for x, k in enumerate(_meridians(weights)):
        stiffness[:, x, :, x] += 20 * k / np.sqrt(np.outer(MASS, MASS))
    largest = np.linalg.eigvalsh(stiffness.reshape(NS * NX, -1))[-1]
    assert 2 / largest / 3 < step <= 2 / largest


@schemes
def test_same_equilibrium_whatever_the_scheme(rng, scheme):
    """A tube blown up by c(s) against w10 and w02: M (w10 L R - c) + K R = 0 for the rings' radius R."""
    w10, w02, spine = 0.01, 3e-5, even_spine(NS)
    c = 0.1 * (1 + 0.4 * np.sin(2.5 * spine[:, 1]))
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    bend = reference.open_stiffness(np.zeros(NS), np.full(NS, w02))
    radius = np.linalg.solve(np.diag(MASS * w10 * lap) + bend, MASS * c)
    assert np.ptp(radius) > 0.05 and np.abs(radius - c / (w10 * lap)).max() > 1e-3
    tube = circles(spine, 0.2, NX) + 0.02 * _fast(rng.normal(size=(NS, NX, 3)))
    rig = Rig((tube, spine), w10=w10, w02=w02, c=c, b=1.0, a=1.0, reaction=0.1, d=0.05)
    solver = make_solver(scheme, rig.model, 0.2, 1.0, 0.5)
    for _ in range(700):
        rig.forces()
        solver.step(rig.state)
    assert np.abs(rig.forces()[0]).max() < 1e-5
    r = np.linalg.norm(rig.tube() - rig.spine()[:, None], axis=-1)
    np.testing.assert_allclose(r, np.tile(radius[:, None], NX), atol=1e-4)


def test_unknown_scheme():
    with pytest.raises(KeyError):
        make_solver("newton", _rig({}).model, DT, SLOW, 0.0)
