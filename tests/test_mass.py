"""Motion with mass (10): the energies that steps keep, decay, frequencies, and what is refused."""

import numpy as np
import pytest

from symseek.sim.body import Body
from symseek.sim.material import Material
from symseek.sim.problem import Tube
from symseek.sim.solvers import SCHEMES, make_solver
from tests import reference
from tests.rig import Rig, circles, even_spine

NX, NS, MU = 12, 11, 0.02
MASS = reference.end_mass(NS)
massive = pytest.mark.parametrize("scheme", [s for s in SCHEMES if SCHEMES[s].bears_mass])
KEYS = ("w10", "w20", "w11", "w01", "w02")


def _rig(closed=False, uneven=True, mu=MU, gamma=0.0, **more):
    """A tube of elastic forces alone: far from its spine, which nothing ties to it, so that no ring counts as thin."""
    spine, rng = even_spine(NS), np.random.default_rng(3)
    radius = 0.2 * np.sqrt(1 - np.linspace(-1, 1, NS) ** 2) if closed else 0.2
    scale = {"w10": 1e-2, "w20": 1e-4, "w11": 2e-6, "w01": 1e-2, "w02": 1e-5}
    weights = {w: k * (rng.uniform(0.3, 1, NS * NX) if uneven else 1.0) for w, k in scale.items()}
    return Rig((circles(spine, radius, NX), spine + np.array([1.0, 0, 0])), closed=closed, mu=mu, gamma=gamma, spine_mu=mu,
               spine_gamma=np.min(gamma), w1=1e-2, **(weights | more))  # fmt: skip


def _weights(rig, closed=False):
    """Those that act, (ns, nx) each: closed ends have no ring force."""
    w = {key: getattr(rig.model, key).numpy().astype(float).reshape(NS, NX) for key in KEYS}
    if closed:
        for key in ("w10", "w20"):
            w[key][[0, -1]] = 0
    return w


def _elastic(tube, spine, w):
    """Half of (2) and (3), whose gradients are twice (4) and (5)."""
    return 0.5 * (reference.tube_energy(tube, **w) + reference.spine_energy(spine, np.full(NS, 1e-2), np.zeros(NS)))


def _kinetic(u, spine_u, mu):
    tube = np.sum(MASS[:, None] * np.sum(u**2, -1)) / (NX * (NS - 1))
    return 0.5 * mu * (tube + np.sum(MASS * np.sum(spine_u**2, -1)) / (NS - 1))


def _energies(scheme, rig, steps, closed=False, h=0.05, every=1):
    """H of steps: kinetic, and elastic of its middle; and what its scheme keeps."""
    solver = make_solver(scheme, rig.model, h if scheme != "euler" else None, None, 0.0)
    h, w = solver.dt, _weights(rig, closed)
    mu, gamma = float(rig.model.mu.numpy()[0]), float(rig.model.gamma.numpy()[0])
    most = {}
    if scheme == "adi":
        most = {k: v.max(0 if k in ("w10", "w20") else 1, keepdims=True) for k, v in _weights(rig).items()}
        most = {k: np.broadcast_to(v, (NS, NX)) * (k != "w11") for k, v in most.items()}
        if closed:
            for key in ("w10", "w20"):
                most[key][[0, -1]] = 0
    plain, kept = [], []
    for step in range(steps):
        rig.forces()
        tube, spine = rig.tube(), rig.spine()
        solver.step(rig.state)
        if step % every:
            continue
        u, spine_u = (a.numpy().astype(float) for a in (rig.state.velocity, rig.state.spine_velocity))
        u = u.reshape(NS, NX, 3)
        plain.append(_kinetic(u, spine_u, mu) + _elastic(0.5 * (tube + rig.tube()), 0.5 * (spine + rig.spine()), w))
        more = 0.0
        if scheme == "euler":  # 1/2 u' (mu M - h^2 K / 4) u + 1/2 w' K w
            more = -(h**2) / 4 * _elastic(u, spine_u, w)
        if scheme == "adi":
            more = h**2 / 4 * (_elastic(u, 0 * spine_u, most) - _elastic(u, 0 * spine_u, w))
            along = reference.open_stiffness(most["w01"][:, 0], most["w02"][:, 0])
            across = np.einsum("st,txc->sxc", along, u)
            around = np.stack([reference.ring_stiffness(most["w10"][s], most["w20"][s]) @ across[s] for s in range(NS)])
            more += h**4 / (32 * mu + 16 * gamma * h) * np.sum(u * around) / (NX * (NS - 1))
        kept.append(plain[-1] + more)
    return np.array(plain), np.array(kept)


@pytest.mark.parametrize("closed", [False, True])
@massive
def test_no_energy_is_lost_or_won_without_damping(scheme, closed):
    """Over 1000 steps of a tube of uneven weights, ends open and closed: what the step keeps, within float32's rounding."""
    rig = _rig(closed)
    plain, kept = _energies(scheme, rig, 1001, closed, every=10)
    assert np.abs(kept / kept[0] - 1).max() < 5e-6
    assert np.abs(plain / plain[0] - 1).max() < 0.05  # and the energy itself stays near it
    if scheme == "direct":
        np.testing.assert_array_equal(plain, kept)


@massive
def test_energy_never_rises_with_damping(scheme):
    """And all of it goes."""
    _, kept = _energies(scheme, _rig(gamma=0.1), 500 if scheme != "euler" else 1000)
    assert np.diff(kept).max() < 1e-7 * kept[0]
    assert kept[-1] < 1e-4 * kept[0]


@massive
def test_a_ring_swings_at_its_own_frequency(scheme):
    """Mode 0 of radius r on even circles: mu r'' + k r = 0, k = w10 L + w20 L^2; its phase after steps of Newmark's rule."""
    rig = _rig(uneven=False, w11=0.0, w01=0.0, w02=0.0)
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    k = float(rig.model.w10.numpy()[0]) * lap + float(rig.model.w20.numpy()[0]) * lap**2
    solver = make_solver(scheme, rig.model, 0.02 if scheme != "euler" else None, None, 0.0)
    h, radius = solver.dt, []
    for _ in range(60):
        rig.forces()
        solver.step(rig.state)
        radius.append(rig.tube()[3, 0, 0])
    # the first step from rest goes half as far as a start by v' = 0 would: r_n = cos(n phi) - c sin(n phi)
    ratio = h**2 * k / MU
    cosine = 1 - ratio / 2 if scheme == "euler" else (1 - ratio / 4) / (1 + ratio / 4)
    phi, n = np.arccos(cosine), np.arange(61)
    fit = np.stack([np.cos(n * phi), np.sin(n * phi)], 1)
    found = np.concatenate([[0.2], radius])
    rest = found - fit @ np.linalg.lstsq(fit, found, rcond=None)[0]
    assert np.abs(rest).max() < 2e-6


@massive
def test_rest_is_that_without_mass(scheme):
    """A tube blown up by c against its tension, damped: the equilibrium of the first-order motion."""
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    spine = even_spine(NS)
    rig = Rig((circles(spine, 0.15, NX), spine), w10=0.01, c=0.1, b=1.0, a=1.0, reaction=0.1, d=0.05,
              mu=0.05, gamma=0.3, spine_mu=0.05, spine_gamma=0.3)  # fmt: skip
    solver = make_solver(scheme, rig.model, None, None, 0.9)
    for _ in range(700):
        rig.forces()
        solver.step(rig.state)
    radius = np.linalg.norm(rig.tube() - rig.spine()[:, None], axis=-1)
    np.testing.assert_allclose(radius, 0.1 / (0.01 * lap), atol=1e-4)
    assert np.abs(rig.state.velocity.numpy()).max() < 1e-5


@massive
def test_velocity_is_the_way_over_the_time(scheme):
    """Of tube and spine, closed ends as one; and the residual keeps speed from passing for rest."""
    rig = _rig(closed=True, gamma=0.01)
    solver = make_solver(scheme, rig.model, 0.03 if scheme != "euler" else None, None, 0.0)
    for _ in range(20):
        rig.forces()
        solver.step(rig.state)
    rig.forces()
    tube, spine, before = rig.tube(), rig.spine(), rig.state.velocity.numpy().reshape(NS, NX, 3).copy()
    solver.step(rig.state)
    np.testing.assert_allclose(rig.state.velocity.numpy().reshape(NS, NX, 3), (rig.tube() - tube) / solver.dt, atol=1e-5)
    np.testing.assert_allclose(rig.state.spine_velocity.numpy(), (rig.spine() - spine) / solver.dt, atol=1e-5)
    np.testing.assert_allclose(np.ptp(rig.tube()[[0, -1]], axis=1), 0, atol=1e-6)
    stop = (MU / solver.dt * MASS[:, None] * before.mean(axis=1)) ** 2
    assert (rig.state.residual.numpy() >= 0.999 * stop.sum(axis=1)).all() and stop.max() > 1e-8


def test_gamma_scales_the_step_of_first_order():
    """gamma v_t: twice the viscosity is half the step; where it is high around a ring, that part lags."""
    force = np.random.default_rng(2).normal(size=(NS * NX, 3)).astype(np.float32)

    def moved(scheme, dt, gamma):
        rig = _rig(uneven=False, mu=0.0, gamma=gamma)
        solver = make_solver(scheme, rig.model, dt, 1.0, 0.0)
        rig.forces()
        before = rig.tube()
        rig.state.force.assign(force)
        solver.step(rig.state)
        return rig.tube() - before

    for scheme in SCHEMES:
        step = 0.4 if scheme != "euler" else 0.02
        np.testing.assert_allclose(moved(scheme, step, 2.0), moved(scheme, step / 2, 1.0), atol=1e-6)
    gamma = np.where(np.arange(NS * NX) % NX < NX // 2, 1.0, 50.0)
    slowed = np.abs(moved("direct", 0.4, gamma)).reshape(NS, NX, 3).mean(axis=(0, 2))
    assert slowed[NX // 2 + 1 : -1].max() < 0.2 * slowed[1 : NX // 2 - 1].min()


def test_the_direct_solver_takes_masses_that_vary_and_the_splitting_says_that_it_does_not():
    """Undamped: 1/2 u' mu M u + 1/2 w' K w, mu over nodes."""
    mu = MU * np.random.default_rng(4).uniform(0.5, 2, NS * NX).astype(np.float32)
    rig = _rig(mu=MU)
    rig.model.mu.assign(mu)
    with pytest.raises(ValueError, match=r'vary over a tube: use solver\.scheme = "direct"'):
        make_solver("adi", rig.model, 0.05, None, 0.0)
    solver, kept, w = make_solver("direct", rig.model, 0.05, None, 0.0), [], _weights(rig)
    for _ in range(300):
        rig.forces()
        tube, spine = rig.tube(), rig.spine()
        solver.step(rig.state)
        u = rig.state.velocity.numpy().astype(float).reshape(NS, NX, 3) * np.sqrt(mu.reshape(NS, NX, 1) / MU)
        energy = _elastic(0.5 * (tube + rig.tube()), 0.5 * (spine + rig.spine()), w)
        kept.append(energy + _kinetic(u, rig.state.spine_velocity.numpy().astype(float), MU))
    assert np.abs(np.array(kept) / kept[0] - 1).max() < 5e-6


@pytest.mark.parametrize(("mu", "gamma"), [(0.0, 0.0), ([0.0] + [0.1] * (NS * NX - 1), 1.0)])
def test_nothing_moves_without_mass_or_viscosity(mu, gamma):
    with pytest.raises(ValueError, match=r"material\.mu must be above 0 everywhere or nowhere, and material\.gamma"):
        make_solver("adi", _rig(mu=0.0, gamma=gamma).model if mu == 0.0 else _with_mu(mu), 0.05, None, 0.0)


def _with_mu(mu):
    rig = _rig()
    rig.model.mu.assign(np.array(mu, np.float32))
    return rig.model


def test_what_is_stopped_again_and_again_gains_nothing():
    """A stiff wave around, let go from rest time after time: energy is only ever taken from it."""
    body = Body(
        [Tube(np.array([[0.0, 0, 0], [0, 1, 0]]), radius=0.1, grid=(24, 9), material=Material(closed=False, mu=0.1))]
    )
    body.material(w20=1e-2, gamma=0.0)
    round_one, spine = body.tube(), body.spine()
    angle = 2 * np.pi * np.arange(24) / 24
    out = (round_one - spine) / np.linalg.norm(round_one - spine, axis=2, keepdims=True)
    body.place(round_one + 1e-3 * np.cos(5 * angle)[:, None, None] * out, spine)
    for _ in range(12):
        body.step(3)
        tube = body.tube()
        radius = np.linalg.norm(tube - tube.mean(axis=0), axis=2)
        assert np.abs(np.fft.rfft(radius, axis=0)[5]).max() / 12 < 1.02e-3
        body.place(tube, body.spine())
