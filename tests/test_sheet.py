"""Snakes and sheets: forces against differences of energies, sheets against a direct solution, snakes against discs."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from symseek.sim.curve import oriented
from symseek.sim.problem import Settings, Sheet, SheetMaterial, Snake, SnakeMaterial, View
from symseek.sim.region import _plain
from symseek.sim.sheet import Sheets
from symseek.sim.snake import LineResult, deform
from symseek.sim.spring import Spring
from tests import reference
from tests.rig import EPS

RNG = np.random.default_rng(11)
BLANK = View(np.full((40, 60), 0.5, np.float32))
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def _plate(nx: int, ns: int, w20: float, w11: float, w02: float, w10: float = 0.0, w01: float = 0.0) -> sparse.csr_array:
    """Half the Hessian of (3) on an open grid, ring after ring, natural on all sides: sum of w |D v|^2 hx hs."""
    hx, hs = 1 / (nx - 1), 1 / (ns - 1)
    mx, ms = sparse.diags_array(reference.end_mass(nx)), sparse.diags_array(reference.end_mass(ns))

    def d1(n, h):
        return sparse.csr_array(np.diff(np.eye(n), axis=0) / h)

    def d2(n, h):
        return sparse.csr_array(np.diff(np.eye(n), 2, axis=0) / h**2)

    x1, x2, s1, s2 = d1(nx, hx), d2(nx, hx), d1(ns, hs), d2(ns, hs)
    k = sparse.kron(ms, w20 * x2.T @ x2 + w10 * x1.T @ x1) + sparse.kron(w02 * s2.T @ s2 + w01 * s1.T @ s1, mx)
    return (k + 2 * w11 * sparse.kron(s1.T @ s1, x1.T @ x1)).tocsr() * hx * hs


def _forces(scene: Sheets) -> np.ndarray:
    """Forces of one iteration, (N, 3) float64, from its elastic launches; the state stays."""
    before = scene.node.numpy().copy()
    scene.force.fill_(np.nan)
    scene.iterate()
    scene.rewind(before)
    return scene.force.numpy().astype(float)


def test_sheet_force_is_half_the_gradient_of_3():
    """On an open, uneven sheet with every weight, natural on all four sides."""
    nx, ns = 9, 7
    material = SheetMaterial(w10=0.3, w01=0.5, w20=0.02, w11=0.01, w02=0.03)
    scene = Sheets([BLANK], [Sheet(SQUARE, grid=(nx, ns), material=material, image=False)], Settings(), "cpu")
    v = RNG.normal(size=(nx * ns, 3)).astype(np.float32)
    scene.rewind(v)
    k = _plate(nx, ns, 0.02, 0.01, 0.03, 0.3, 0.5)
    gradient = reference.gradient(lambda u: float(np.sum(u * (k @ u))), v.astype(float), 1e-2)
    h = (nx - 1) * (ns - 1)
    atol = 64 * EPS * np.abs(v).max() * (0.02 * 8**4 + 0.03 * 6**4 + 0.01 * h**2)
    np.testing.assert_allclose(_forces(scene), -0.5 * gradient * h, rtol=0, atol=atol)
    assert np.abs(gradient * h).max() > 1e4 * atol


@pytest.mark.parametrize("closed", [True, False])
def test_snake_force_is_minus_the_gradient_of_its_energy(closed):
    """(2) and K1/2 (|v'| - L1)^2 of long edges and of the end ones, L1 held; spacing acts along the curve alone."""
    n, w1, w2, k1 = 12, 0.2, 1e-4, 0.3
    h = 1 / n if closed else 1 / (n - 1)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    points = 20 + 10 * np.stack([np.cos(angle), np.sin(angle)], 1) + RNG.normal(size=(n, 2))
    snake = Snake(oriented(points), closed=closed, nodes=n, material=SnakeMaterial(w1, w2, k1))
    scene = Sheets([BLANK], [snake], Settings(gain=0.0, potential="brightness"), "cpu")
    v = (scene.node.numpy() + 0.02 * RNG.normal(size=(n, 3))).astype(np.float32)
    scene.rewind(v)

    def edges(u):
        return (np.roll(u, -1, axis=0) - u)[: n if closed else n - 1]

    natural = np.linalg.norm(edges(v.astype(float)), axis=1).mean() if closed else 1 / (n - 1)

    def energy(u):
        e = edges(u)
        bend = np.roll(u, -1, axis=0) - 2 * u + np.roll(u, 1, axis=0)
        bend = bend if closed else bend[1:-1]
        long = np.linalg.norm(e, axis=1) - natural
        long[slice(None) if closed else slice(1, -1)] = np.maximum(long[slice(None) if closed else slice(1, -1)], 0)
        return 0.5 * h * (w1 * np.sum(e**2) / h**2 + w2 * np.sum(bend**2) / h**4 + k1 * np.sum(long**2) / h**2)

    u = v.astype(float)
    expected = -reference.gradient(energy, u, 1e-6) / h
    t = np.roll(u, -1, axis=0) - np.roll(u, 1, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    even = k1 / h**2 * np.sum((np.roll(u, -1, axis=0) - 2 * u + np.roll(u, 1, axis=0)) * t, axis=1)[:, None] * t
    if not closed:
        even[[0, -1]] = 0
    force = _forces(scene)
    np.testing.assert_allclose(force, expected + even, rtol=0, atol=1e-4 * np.abs(force).max())


def _loaded(nx: int, ns: int, w: float, stiffness: float, load: float) -> np.ndarray:
    """Heights (N_x, N_s) of a square plate on springs at its corners, by one sparse direct solution."""
    held = np.zeros(nx * ns)
    held[[0, nx - 1, nx * ns - 1, nx * (ns - 1)]] = stiffness
    mass = np.kron(reference.end_mass(ns), reference.end_mass(nx)) / ((nx - 1) * (ns - 1))
    stiff = sparse.csr_array(_plate(nx, ns, w, w, w) + sparse.diags_array(held))
    return np.asarray(spsolve(stiff, mass * load)).reshape(ns, nx).T


def _hung(nx: int, ns: int, w: float, stiffness: float, load: float) -> LineResult:
    springs = tuple(Spring(tuple(map(float, a)), point=(float(a[0]), float(a[1])), stiffness=stiffness) for a in SQUARE)
    material = SheetMaterial(0, 0, w, w, w)
    sheet = Sheet(SQUARE, grid=(nx, ns), material=material, load=(0, 0, load), image=False, springs=springs)
    return deform([BLANK], [sheet], Settings(tolerance=1e-7)).objects[0]


@pytest.mark.parametrize(("w", "load"), [(0.02, 0.4), (1e-3, -0.02)])
def test_sheet_held_at_its_corners_under_an_even_load(w, load):
    """Against the sparse direct solution of the same discrete plate, springs included; nothing moves in its plane."""
    nx, ns = 17, 13
    found = _hung(nx, ns, w, 5.0, load)
    z = _loaded(nx, ns, w, 5.0, load)
    assert found.converged
    np.testing.assert_allclose(found.nodes[0, ..., 2], z, atol=1e-3 * np.abs(z).max())
    plane = np.stack(np.meshgrid(np.linspace(0, 1, nx), np.linspace(0, 1, ns), indexing="ij"), -1)
    np.testing.assert_allclose(found.nodes[0, ..., :2], plane, atol=1e-4)
    assert np.abs(z).max() > 0.1


def test_sheet_converges_with_its_grid():
    """The middle of that plate: second order from 9 to 65 nodes a side, against the direct solution at 129."""
    exact = _loaded(129, 129, 0.02, 5.0, 0.4)[64, 64]
    sizes = (9, 17, 33)
    errors = [abs(_hung(n, n, 0.02, 5.0, 0.4).nodes[0, n // 2, n // 2, 2] - exact) for n in sizes]
    assert reference.slope([n - 1 for n in sizes], errors) >= 1.8


def _disc(radius: float, middle: np.ndarray, noise: float = 0.0, dark: bool = False) -> np.ndarray:
    """A disc by 8 x 8 points a pixel, shape (160, 180)."""
    y, x = ((np.arange(8 * n) + 0.5) / 8 - 0.5 for n in (160, 180))
    cover = (np.hypot(x - middle[0], y[:, None] - middle[1]) < radius).reshape(160, 8, 180, 8).mean(axis=(1, 3))
    cover = 1 - cover if dark else cover
    return (0.1 + 0.8 * cover + noise * np.random.default_rng(2).normal(size=cover.shape)).astype(np.float32)


MIDDLE = np.array([88.3, 79.6])


def _ring(radius: float, count: int = 16) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return MIDDLE + [3, -2] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    ("look", "start", "nodes"),
    [({}, 60, 50), ({}, 60, 400), ({}, 42, 100), ({"dark": True}, 58, 100), ({"noise": 0.05}, 60, 200)],
)
def test_snake_finds_a_disc(look, start, nodes):
    """Radius 50 px: within a twentieth of a pixel, noise within a tenth, from outside and inside, given in either sense."""
    points = _ring(start)[:: -1 if nodes == 400 else 1]
    found = deform([View(_disc(50, MIDDLE, **look))], [Snake(points, nodes=nodes)]).objects[0]
    off = np.linalg.norm(found.contour[0] - MIDDLE, axis=1) - 50
    assert np.abs(off).mean() < (0.1 if "noise" in look else 0.05)
    assert found.converged and found.trusted
    np.testing.assert_allclose(found.measures["length"], 2 * np.pi * 50, rtol=2e-3)
    np.testing.assert_allclose(found.measures["area"], np.pi * 50**2, rtol=4e-3)
    assert found.measures["supported_share"] > 0.98


def test_snakes_of_50_and_400_nodes_lie_on_the_same_curve():
    image = _disc(50, MIDDLE, 0.02)
    few, many = (deform([View(image)], [Snake(_ring(60), nodes=n)]).objects[0].contour[0] for n in (50, 400))
    angle = [np.arctan2(*(c[:-1] - MIDDLE).T) for c in (few, many)]
    radius = [np.linalg.norm(c[:-1] - MIDDLE, axis=1) for c in (few, many)]
    order = np.argsort(angle[1])
    there = np.interp(angle[0], angle[1][order], radius[1][order], period=2 * np.pi)
    assert np.abs(radius[0] - there).max() < 0.1


def test_open_snake_finds_an_edge():
    """A wavy edge from a straight line 4 px off: within a tenth of a pixel, its ends where they were along it."""
    y, x = ((np.arange(8 * n) + 0.5) / 8 - 0.5 for n in (120, 200))
    wave = 60 + 6 * np.sin(x / 25)
    cover = (y[:, None] > wave).reshape(120, 8, 200, 8).mean(axis=(1, 3))
    rng = np.random.default_rng(0)
    image = (0.2 + 0.5 * cover + 0.01 * rng.normal(size=cover.shape)).astype(np.float32)
    found = deform([View(image)], [Snake(np.array([[30.0, 63], [90, 59], [170, 63]]), closed=False)]).objects[0]
    line = found.contour[0]
    slope = 6 / 25 * np.cos(line[:, 0] / 25)
    off = (line[:, 1] - 60 - 6 * np.sin(line[:, 0] / 25)) / np.sqrt(1 + slope**2)
    assert found.converged and "area" not in found.measures
    assert np.abs(off[20:-20]).mean() < 0.1 and np.abs(off).max() < 1.0
    assert abs(line[0, 0] - 30) < 4 and abs(line[-1, 0] - 170) < 4


def test_a_spring_pulls_a_snake_off_and_it_returns():
    """40 px off the disc, and back within half a pixel when it lets go."""
    edge = MIDDLE + np.array([50.0, 0])
    spring = Spring((edge[0] + 40, edge[1]), near=tuple(edge), start=200, stop=500)
    far = []

    def watch(progress):
        if progress.iteration == 500:
            far.append(progress.nodes()[:, 0, :2])

    image = View(_disc(50, MIDDLE, 0.01))
    rest = deform([image], [Snake(_ring(58))]).objects[0]
    found = deform([image], [Snake(_ring(58), springs=(spring,))], callback=watch).objects[0]
    assert np.linalg.norm(far[0] - MIDDLE, axis=1).max() > 50 + 38
    off = np.abs(np.linalg.norm(found.contour[0] - MIDDLE, axis=1) - 50)
    assert off.max() < 0.5 and found.converged and found.iterations > 500
    assert abs(off.mean() - np.abs(np.linalg.norm(rest.contour[0] - MIDDLE, axis=1) - 50).mean()) < 0.02


def test_a_volcano_keeps_a_snake_away():
    edge = MIDDLE + np.array([0.0, -50])
    volcano = Spring(tuple(edge), stiffness=20.0, reach=10.0)
    found = deform([View(_disc(50, MIDDLE))], [Snake(_ring(55), springs=(volcano,))], Settings(iterations=600)).objects[0]
    assert np.linalg.norm(found.nodes[0] - edge, axis=1).min() > 5


def test_sheet_border_goes_to_the_outline():
    """A square sheet spreads over the disc: its border on the edge but for the corners, its area the disc's."""
    c = np.array([[-38.0, -38], [38, -38], [38, 38], [-38, 38]]) + MIDDLE + [2, 1]
    found = deform([View(_disc(50, MIDDLE))], [Sheet(c)], Settings()).objects[0]
    off = np.abs(np.linalg.norm(found.contour[0] - MIDDLE, axis=1) - 50)
    assert np.median(off) < 0.5 and found.measures["supported_share"] > 0.8
    np.testing.assert_allclose(found.measures["area"], np.pi * 50**2, rtol=0.03)
    np.testing.assert_allclose(found.nodes[0, ..., 2], 0, atol=1e-3)  # nothing moves in depth


@pytest.mark.parametrize(
    ("patch", "value", "plain"), [(None, 0, True), ((30, 60), 1.0, False), ((5, 5), 6.0, False), ((30, 32), -6.0, False)]
)
def test_colours_alone_decide_only_where_nothing_is_doubtful(patch, value, plain):
    """A disc of plain odds, its rim of none; not with a patch that is unsure, of its colours elsewhere, of others within."""
    y, x = np.mgrid[:80, :80]
    off = np.hypot(x - 32, y - 30)
    odds = np.where(np.abs(off - 20) < 0.7, 0.0, np.where(off < 20, 6.0, -6.0))
    if patch is not None:
        odds[patch[0] - 3 : patch[0] + 3, patch[1] - 3 : patch[1] + 3] = value
    assert _plain(odds, off < 10, off > 45) == plain
