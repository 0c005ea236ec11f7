"""The matrix of a step, over-relaxation, the direct solver; every scheme against the sparse direct step; longest steps."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from symseek.sim.solvers import SCHEMES, SolverSOR, choose, make_solver
from symseek.sim.solvers.bounds import STRETCH
from symseek.sim.solvers.matrix import step_matrix
from symseek.sim.solvers.sor import colors
from tests import reference
from tests.rig import Rig, circles, even_spine

NX, NS, DT = 9, 7, 0.4
B = np.linspace(0.5, 1.5, NS)
MASS = reference.end_mass(NS)


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def weights(rng):
    scale = {"w10": 1e-2, "w20": 1e-4, "w11": 1e-5, "w01": 1e-2, "w02": 3e-4}
    return {w: (k * rng.uniform(0.2, 1, (NS, NX))).astype(np.float32).astype(float) for w, k in scale.items()}


def _rig(weights, closed=False, **more):
    radius = np.full(NS, 0.2)
    if closed:
        radius[[0, -1]] = 0
    tube = circles(even_spine(NS), radius, NX)
    more = {"b": B, "a": 0.7, "w1": 2e-2, "w2": 1e-3, "k1": 0.05} | more
    return Rig((tube, even_spine(NS)), closed=closed, **{w: a.ravel() for w, a in weights.items()}, **more)


def _stiffness(weights, closed=False):
    """K of the tube, from its energy (3) alone; closed ends have no ring force. (n, n)."""
    free = _free(closed)[:, None]
    weights = weights | {"w10": free * weights["w10"], "w20": free * weights["w20"]}
    scale = 0.5 * NX * (NS - 1)  # (3) has no half in front, and forces are loads per hx hs

    def energy(v):
        return scale * reference.tube_energy(v, **weights)

    return np.stack([reference.gradient(energy, unit.reshape(NS, NX, 1)).ravel() for unit in np.eye(NS * NX)])


def _free(closed):
    return np.array([1.0 - closed, *np.ones(NS - 2), 1.0 - closed])


def _dense(weights, dt, closed=False):
    """M (1 + dt b) + dt K of the tube, without b at closed ends."""
    return np.diag(np.repeat(MASS * (1 + dt * B * _free(closed)), NX)) + dt * _stiffness(weights, closed)


def _spine(dt):
    """M (1 + dt a) + dt K of the spine."""
    return np.diag(MASS * (1 + dt * 0.7)) + dt * reference.open_stiffness(np.full(NS, 2e-2 + 0.05), np.full(NS, 1e-3))


def _solved(matrix, right):
    """By SciPy's sparse solver, right (n, 3)."""
    return np.array(spsolve(sparse.csc_array(matrix), right))


def _step(rig, solver, force, spine_force):
    """How far given forces move tube and spine."""
    rig.forces()
    tube, spine = rig.tube(), rig.spine()
    rig.state.force.assign(force.reshape(-1, 3).astype(np.float32))
    rig.state.spine_force.assign(spine_force.astype(np.float32))
    solver.step(rig.state)
    return rig.tube() - tube, rig.spine() - spine


@pytest.mark.parametrize("closed", [False, True])
def test_a_whole_step_is_the_energys_matrix(weights, closed):
    """Of an open tube all nodes; of a closed one the inner rings, and each end's nodes as one."""
    solver = make_solver("direct", _rig(weights, closed).model, DT, 1.0, 0.0)
    found = step_matrix(solver).toarray()
    n = NS * NX
    if closed:
        ends = np.zeros((n, 2))
        ends[:NX, 0] = ends[-NX:, 1] = 1
        inner = np.arange(NX, n - NX)
        nodes = np.concatenate([np.eye(n)[:, inner], ends], axis=1)
        expected = nodes.T @ _dense(weights, DT, closed) @ nodes
        expected[-2:] /= NX
        at = np.concatenate([inner, [n, n + NS - 1]])
    else:
        expected, at = _dense(weights, DT), np.arange(n)
    np.testing.assert_allclose(found[np.ix_(at, at)], expected, atol=1e-6 * np.abs(expected).max())
    line = n + 3 * NS + np.arange(NS)
    np.testing.assert_allclose(found[np.ix_(line, line)], _spine(solver.spine_dt), rtol=1e-6, atol=1e-6)
    used = np.concatenate([at, line])
    rest = np.setdiff1d(np.arange(len(found)), used)
    np.testing.assert_array_equal(found[rest], np.eye(len(found))[rest])
    assert not found[np.ix_(used, rest)].any()


def test_the_direct_step_is_scipys(rng, weights):
    """SciPy's own sparse solve of matrices made from the energies."""
    force, spine_force = rng.normal(size=(NS, NX, 3)), rng.normal(size=(NS, 3))
    rig = _rig(weights)
    solver = make_solver("direct", rig.model, DT, 1.0, 0.0)
    moved, spine_moved = _step(rig, solver, force, spine_force)
    expected = _solved(_dense(weights, DT), DT * force.reshape(-1, 3))
    np.testing.assert_allclose(moved.reshape(-1, 3), expected, atol=3e-6)
    own = solver.spine_dt
    np.testing.assert_allclose(spine_moved, _solved(_spine(own), own * spine_force), atol=1e-5)


def _even(**more):
    return {"w10": np.full((NS, NX), 1e-2), "w20": np.full((NS, NX), 1e-4), "w11": np.zeros((NS, NX)),
            "w01": np.full((NS, NX), 1e-2), "w02": np.full((NS, NX), 3e-4)} | more  # fmt: skip


@pytest.mark.parametrize(("scheme", "order"), [("direct", None), ("adi", 2), ("jacobi", 1), ("euler", 1), ("sor", None)])
def test_every_step_is_near_the_sparse_direct_one(rng, scheme, order):
    """How far off falls as dt^2 for the splitting, as dt for explicit steps; none is left where a scheme solves P itself."""
    force = rng.normal(size=(NS, NX, 3))
    spectrum = np.fft.fft(force, axis=1)
    spectrum[:, [0, 1, -1]] = 0  # slow modes have lines of their own in some schemes
    force, steps, errors = np.fft.ifft(spectrum, axis=1).real, [2, 4, 8], []
    inertia, stiffness = np.repeat(MASS, NX), _stiffness(_even())
    for dt in 1e-3 * np.array(steps):
        rig = _rig(_even())
        solver = make_solver(scheme, rig.model, dt, 1.0, 0.0)
        if isinstance(solver, SolverSOR):
            solver.sweeps = 60
        moved, _ = _step(rig, solver, 100 * force, np.zeros((NS, 3)))
        matrix = np.diag(inertia * (1 + dt * np.repeat(B, NX))) + dt * stiffness
        exact = _solved(matrix, dt * 100 * force.reshape(-1, 3)).reshape(force.shape)
        errors.append(np.abs(moved - exact).max() / np.abs(exact).max())
    if order is None:
        assert max(errors) < 2e-6
    else:
        assert abs(-reference.slope(steps, errors) - order) < 0.25


@pytest.mark.parametrize("closed", [False, True])
def test_over_relaxation_sweeps_by_colour_and_ends_at_the_direct_step(rng, weights, closed):
    """One sweep is (D / omega + L)^-1 in the order of colours, L what comes before; many are the solution."""
    force, spine_force = rng.normal(size=(NS, NX, 3)), rng.normal(size=(NS, 3))
    rig = _rig(weights, closed)
    solver = make_solver("sor", rig.model, DT, 1.0, 0.0)
    assert isinstance(solver, SolverSOR)
    direct = _step(_rig(weights, closed), make_solver("direct", rig.model, DT, 1.0, 0.0), force, spine_force)
    moved, _ = _step(rig, solver, force, spine_force)
    if not closed:
        color = colors(NX, NS).ravel()
        matrix = _dense(weights, DT)
        before = color[:, None] > color[None]
        swept = np.linalg.solve(np.diag(np.diag(matrix)) / solver.omega + matrix * before, DT * force.reshape(-1, 3))
        np.testing.assert_allclose(moved.reshape(-1, 3), swept, atol=3e-6)
    solver.sweeps = 400
    for found, exact in zip(_step(rig, solver, force, spine_force), direct, strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-5)


@pytest.mark.parametrize("nx", range(8, 34))
def test_no_two_nodes_of_a_colour_meet(nx):
    """In the matrix of all of (3), twist included, whatever the number of nodes; and few colours do."""
    ns = 6 + nx % 5
    rig = Rig((circles(even_spine(ns), 0.2, nx), even_spine(ns)), w10=1.0, w20=1.0, w11=1e-6, w01=1.0, w02=1.0)
    matrix = step_matrix(make_solver("direct", rig.model, 1.0, 1.0, 0.0)).tocoo()
    color = colors(nx, ns).ravel()
    nodes = (matrix.row < nx * ns) & (matrix.col < nx * ns)
    apart = nodes & (matrix.row != matrix.col) & (matrix.data != 0)
    assert np.bincount(matrix.row[apart], minlength=nx * ns).max() == 12  # the full stencil
    assert (color[matrix.row[apart]] != color[matrix.col[apart]]).all()
    assert color.max() + 1 == (5 if nx % 5 == 0 else -(-nx // (nx // 5)))


def _shaken(rig, scheme, dt, load, rng):
    """Whether a straight tube, held by springs on two opposite meridians, stays where it is when shaken a little."""
    kind = type(scheme, (SCHEMES[scheme],), {"bears": lambda self, dt: True})
    solver, start = kind(rig.model, dt, 1.0, 0.0), rig.tube()
    springs = np.zeros((NS, NX, 1))
    springs[:, [0, NX // 2]] = load * NX * MASS[:, None, None]
    rig.state.tube.assign((start + 1e-4 * rng.normal(size=start.shape)).reshape(-1, 3).astype(np.float32))
    for _ in range(400):
        force, _ = rig.forces()
        rig.state.force.assign((force + springs * (start - rig.tube())).reshape(-1, 3).astype(np.float32))
        solver.step(rig.state)
    return np.abs(rig.tube() - start).max() < 1e-2


@pytest.mark.parametrize("mu", [0.0, 0.05])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_each_scheme_bears_the_step_that_it_says_and_refuses_a_longer_one(rng, scheme, mu):
    """Against a stiff pull on the contour: stable within its word, and where theory is sharp unstable not far beyond."""
    lap = (2 * NX * np.sin(np.pi / NX)) ** 2
    w20, load = 1e-3, 2.0

    def rig():
        tube = circles(even_spine(NS), 0.2, NX)
        rig = Rig((tube, even_spine(NS)), w20=w20, w02=1e-5, w2=1e-5, a=1.0, b=1.0, reaction=0.1, d=0.05,
                  balance=w20 * lap**2, mu=mu, spine_mu=mu)  # fmt: skip
        rig.model.image_load[:] = load / STRETCH
        return rig

    if mu and not SCHEMES[scheme].bears_mass:
        with pytest.raises(ValueError, match=f'"{scheme}" does not integrate material.mu'):
            make_solver(scheme, rig().model, None, 1.0, 0.0)
        return
    longest = make_solver(scheme, rig().model, None, 1.0, 0.0).longest_step()
    assert 0 < longest < np.inf
    with pytest.raises(ValueError, match=f"too long for .* at most {longest:.3g}"):
        make_solver(scheme, rig().model, 1.01 * longest, 1.0, 0.0)
    make_solver(scheme, rig().model, 0.99 * longest, 1.0, 0.0)
    assert _shaken(rig(), scheme, 0.85 * longest, load, rng)
    if scheme in ("adi", "direct"):
        assert not _shaken(rig(), scheme, 1.3 * longest, load, rng)


def test_twist_bounds_the_splitting_only_beyond_the_rigidities_mean(weights):
    """w11 up to sqrt(w20 w02) is borne at any step by the splitting, more at a short one; the direct solver has it in P."""
    w20, w02 = 1e-4, 1e-6

    def longest(scheme, w11):
        rig = Rig((circles(even_spine(17), 0.2, 16), even_spine(17)), w20=w20, w02=w02, w11=w11)
        return make_solver(scheme, rig.model, None, None, 0.0).longest_step()

    root = np.sqrt(w20 * w02)
    assert longest("adi", 0.9 * root) == np.inf
    assert longest("adi", 10 * root) < 0.4
    assert longest("direct", 10 * root) == np.inf


def test_the_default_is_alternating_directions_unless_they_cannot(weights):
    assert choose(_rig(weights | {"w11": 0 * weights["w11"]}).model) == "adi"
    assert choose(_rig(weights, mu=0.1, spine_mu=0.1).model) == "adi"
    uneven = np.linspace(0.1, 0.2, NS * NX)
    assert choose(_rig(weights, mu=uneven, spine_mu=0.1).model) == "direct"
    stiff = _rig(weights | {"w11": np.full((NS, NX), 0.1)}).model
    assert choose(stiff) == "direct"
    assert make_solver("auto", stiff, None, None, 0.0).name == "direct"
