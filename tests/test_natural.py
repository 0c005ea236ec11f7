"""Natural lengths and curvatures (section 3): forces against their energies, bars and tubes that take them."""

from typing import Any

import numpy as np
import pytest

from symseek.sim.body import Body
from symseek.sim.material import Material
from symseek.sim.problem import Tube
from tests import reference
from tests.rig import EPS, Rig, circles, even_spine

RNG = np.random.default_rng(9)
NX, NS = 8, 9
HX, HS = 1 / NX, 1 / (NS - 1)
MASS = reference.end_mass(NS)
SPINE = (even_spine(NS) + 0.03 * RNG.normal(size=(NS, 3))).astype(np.float32).astype(float)
TUBE = (circles(SPINE, 0.3, NX) + 0.03 * RNG.normal(size=(NS, NX, 3))).astype(np.float32).astype(float)


def _field(low, high, shape=(NS, NX)):
    return RNG.uniform(low, high, shape).astype(np.float32).astype(float)


def _triples(*fields):
    return np.stack([np.broadcast_to(f, (NS, NX)).ravel() for f in fields], -1)


def _lengths(edges, h, k, natural, most):
    """Sum of 2 int_L^g K min(t - L, most) t dt over edges: K (g - L)^2 (2 g + L) / 3 up to g = L + most."""
    g = np.linalg.norm(edges, axis=-1) / h
    paper = np.minimum(g, natural + most)
    energy = k * (paper - natural) ** 2 * (2 * paper + natural) / 3
    return np.sum(energy + k * most * (np.maximum(g, paper) ** 2 - paper**2))


def _sheet(v, w, c):
    """w20 |v_xx + C20 n|^2 + 2 w11 |v_xs + C11 n|^2 + w02 |v_ss + C02 n|^2 less the same without C, per hx hs."""
    east, west = np.roll(v, -1, axis=1), np.roll(v, 1, axis=1)
    low, high = np.maximum(np.arange(NS) - 1, 0), np.minimum(np.arange(NS) + 1, NS - 1)
    n = np.cross(east - west, v[high] - v[low])
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    square = lambda q: np.sum(q**2, -1)  # noqa: E731
    xx = (east - 2 * v + west) / HX**2
    energy = np.sum(MASS[:, None] * w["w20"] * (square(xx + c["C20"][..., None] * n) - square(xx)))
    ss = np.diff(v, 2, axis=0) / HS**2
    inner = slice(1, -1)
    energy += np.sum((w["w02"] * (square(np.pad(ss, ((1, 1), (0, 0), (0, 0))) + c["C02"][..., None] * n)))[inner])
    energy -= np.sum(w["w02"][inner] * square(ss))
    dx, ds = east - v, np.diff(v, axis=0)
    n = np.cross(dx[:-1] + dx[1:], ds + np.roll(ds, -1, axis=1))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    xs = np.diff(dx, axis=0) / (HX * HS)
    return energy + np.sum(2 * w["w11"][:-1] * (square(xs + c["C11"][:-1, :, None] * n) - square(xs)))


def _shaped(**weights):
    rig = Rig((TUBE, SPINE), **weights)
    rig.model.shaped = True
    return rig


def _compare(force, energy, v, scale):
    """Half the gradient, per hx hs; float32's rounding of numbers of size `scale`."""
    expected = -0.5 * reference.gradient(energy, v, 1e-5)
    np.testing.assert_allclose(force, expected, rtol=0, atol=20 * EPS * scale)
    assert np.abs(expected).max() > 2e3 * EPS * scale


@pytest.mark.parametrize("name", ["stretch10", "stretch01"])
def test_natural_lengths_of_the_sheet_are_half_a_gradient(name):
    """Edges shorter and longer than natural, and some beyond where the tension weight is held."""
    edges, h, mass = (
        (lambda v: np.roll(v, -1, axis=1) - v, HX, MASS[:, None])
        if name == "stretch10"
        else (lambda v: np.diff(v, axis=0, append=v[-1:]), HS, np.append(np.ones(NS - 1), 0.0)[:, None])
    )
    g = np.linalg.norm(edges(TUBE), axis=-1) / h
    natural, k, most = g * _field(0.3, 2.5), _field(0.2, 1), g * _field(0.1, 1.5)
    natural[-1], most[-1] = natural[-1] + 1e-3, most[-1] + 1e-3
    assert np.any(g > natural + most) and np.any(g < natural)
    force, _ = _shaped(**{name: _triples(k, natural, most)}).forces()
    _compare(force, lambda v: _lengths(edges(v), h, k * mass, natural, most), TUBE, (g * (g + natural)).max() / h)


@pytest.mark.parametrize("name", ["C20", "C11", "C02", "all"])
def test_natural_curvature_of_the_sheet_is_half_a_gradient(name):
    w = {w: _field(0.2, 1) for w in ("w20", "w11", "w02")}
    c = {n: _field(-20, 20) if name in (n, "all") else np.zeros((NS, NX)) for n in ("C20", "C11", "C02")}
    flat = {key: a.ravel() for key, a in w.items()}
    plain, _ = Rig((TUBE, SPINE), **flat).forces()
    shaped, _ = _shaped(**flat, curvature=_triples(c["C20"], c["C11"], c["C02"])).forces()
    _compare(shaped - plain, lambda v: _sheet(v, w, c), TUBE, np.abs(plain).max() + 20 / HS**2)


@pytest.mark.parametrize("name", ["L1", "C2", "both"])
def test_natural_shape_of_the_spine_is_half_a_gradient(name):
    """K1 lengths, and w2 (|q|^2 - 2 C2 p.(t x q)) in the best plane p; the nudge aside."""
    edges = np.linalg.norm(np.diff(SPINE, axis=0), axis=1) / HS
    k1, w2 = _field(0.2, 1, NS), _field(0.2, 1, NS)
    natural, most = np.append(edges, 1) * _field(0.4, 2, NS), np.full(NS, 0.3, np.float32)
    c2 = _field(-2, 5, NS)
    length, curve = name != "C2", name != "L1"
    given: dict[str, Any] = {"k1": k1, "spine_stretch": np.stack([natural, most], -1)} if length else {}
    given |= {"w2": w2, "spine_curvature": np.stack([np.ones(NS), c2], -1)} if curve else {}
    rig = Rig((TUBE, SPINE), **given)
    _, force = rig.forces()

    def energy(v):
        out = _lengths(np.diff(v, axis=0), HS, k1[:-1], natural[:-1], most[:-1]) if length else 0.0
        if curve:
            q = np.diff(v, 2, axis=0) / HS**2
            t = v[2:] - v[:-2]
            t /= np.linalg.norm(t, axis=1, keepdims=True)
            turning = np.sum((w2 * c2)[1:-1, None] * np.cross(t, q), axis=0)
            out += np.sum(w2[1:-1] * np.sum(q**2, axis=1)) - 2 * np.linalg.norm(turning)
        return out

    expected = -0.5 * reference.gradient(energy, SPINE, 1e-5)
    # the nudge turns the plane a little
    scale = np.abs(expected).max()
    np.testing.assert_allclose(force, expected, rtol=0, atol=3e-3 * scale if curve else 1e-6 * scale)


def _body(**material):
    axis = np.array([[0, 0, 0], [0, 1.0, 0]])
    return Body([Tube(axis, radius=0.1, material=Material(closed=False, **material))])


def _turning(p):
    """Angle between each two edges in a row, and the normals of the planes they span."""
    t = np.diff(p, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    normal = np.cross(t[:-1], t[1:])
    return np.arctan2(np.linalg.norm(normal, axis=1), np.sum(t[1:] * t[:-1], axis=1)), normal


BENDS = {"straight": 0.0, "less": 0.5, "more": 2.4}


@pytest.mark.parametrize("start", BENDS)
def test_a_bar_takes_its_natural_curvature(start):
    """C2 = 1.2 and L1 = 1: an arc of that angle and length, in one plane, from any bend before; turned, it is the same."""
    body = _body(w2=1e-3, C2=1.2, k1=1.0, L1=1.0, w02=0.0)
    if BENDS[start]:
        tube, spine = body.tube(), body.spine()
        angle = BENDS[start] * spine[:, 1]
        arc = np.stack([1 - np.cos(angle), np.sin(angle), 0 * angle], -1) / BENDS[start]
        turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
        body.place((tube - spine + arc) @ turn.T, arc @ turn.T)
    body.step(400)
    angles, normals = _turning(body.spine())
    np.testing.assert_allclose(angles * 24, 1.2, rtol=0.01)
    length = np.linalg.norm(np.diff(body.spine(), axis=0), axis=1)
    np.testing.assert_allclose(length * 24, 1.0, rtol=0.01)
    assert np.sum(normals[1:] * normals[:-1], axis=1).min() > 0  # one way, no zigzag


@pytest.mark.parametrize("around", [0.5, 0.8, 1.25, 2.0])
@pytest.mark.parametrize("along", [0.5, 0.8, 1.25, 2.0])
def test_a_tube_takes_its_natural_lengths(around, along):
    """From compressed and stretched starts: every edge within 1 %."""
    body = _body(k10=0.1, L10=2 * np.pi * 0.1, k01=0.1, L01=1.0)
    tube, spine = body.tube(), body.spine()
    body.place(tube * [around, along, around], spine * [1, along, 1])
    assert body.rest()
    tube = body.tube()
    ring = np.linalg.norm(np.roll(tube, -1, axis=0) - tube, axis=2) * 25
    meridian = np.linalg.norm(np.diff(tube, axis=1), axis=2) * 24
    np.testing.assert_allclose(ring, 2 * np.pi * 0.1, rtol=0.01)
    np.testing.assert_allclose(meridian, 1.0, rtol=0.01)


def test_lengths_may_differ_over_the_sheet():
    """A cone by L10 along s, and twice the length of ring spacing towards one end."""
    s = np.linspace(0, 1, 25)
    body = _body(k10=0.1, L10=2 * np.pi * (0.05 + 0.1 * s), k01=0.1, L01=0.5 + s, w02=0.0)
    assert body.rest()
    tube = body.tube()
    radius = np.linalg.norm(tube - tube.mean(axis=0), axis=2)
    # inscribed polygons whose sides sum to L10
    expected = (0.05 + 0.1 * s) * np.pi / 25 / np.sin(np.pi / 25)
    np.testing.assert_allclose(radius, np.tile(expected, (25, 1)), rtol=0.01)
    meridian = np.linalg.norm(np.diff(tube, axis=1), axis=2) * 24
    np.testing.assert_allclose(meridian, np.tile((0.5 + s)[:-1], (25, 1)), rtol=0.01)


@pytest.mark.parametrize(("radius", "w20", "factor"), [(0.1, 1e-4, 0.6), (0.1, 1e-4, 1.6), (0.3, 1e-3, 0.3)])
def test_a_tube_takes_its_natural_curvature_around(radius, w20, factor):
    """C20 = (2 pi)^2 r for a ring of radius r, in its discrete form 2 n^2 (1 - cos(2 pi / n)) r; rings stay smooth along."""
    n = 25
    body = _body(C20=2 * n**2 * (1 - np.cos(2 * np.pi / n)) * radius, w20=w20)
    body.place((body.tube() - body.spine()) * 10 * radius * factor + body.spine(), body.spine())
    assert body.rest()
    np.testing.assert_allclose(np.linalg.norm(body.tube() - body.spine(), axis=2), radius, rtol=0.01)


def test_a_tube_stays_in_the_shape_that_is_made_its_natural_one():
    """A bent, tapered tube: its lengths and curvatures as they are; without them it shrinks."""
    s = np.linspace(0, 1, 25)
    spine = np.stack([1 - np.cos(s), np.sin(s), 0 * s], -1)
    side, up = np.stack([np.cos(s), -np.sin(s), 0 * s], -1), np.array([0, 0, 1.0])
    angle = 2 * np.pi * np.arange(25)[:, None] / 25
    tube = spine + (0.1 + 0.05 * s)[:, None] * (np.cos(angle)[..., None] * side - np.sin(angle)[..., None] * up)
    free = {"reaction": 1.0, "b": 0.1, "k10": 0.05, "k01": 0.05, "k1": 0.05}
    free |= {"w2": 1e-4, "w20": 1e-4, "w02": 1e-5, "w11": 1e-7}
    moved = {}
    for kept in (True, False):
        body = _body(**free)
        body.place(tube, spine)
        if kept:
            shape: Any = body.shape()
            np.testing.assert_allclose(shape["C2"][1:-1], 1.0, rtol=1e-3)  # it turns by 1 rad
            np.testing.assert_allclose(shape["L10"], np.tile(2 * np.pi * (0.1 + 0.05 * s), (25, 1)), rtol=0.01)
            np.testing.assert_allclose(shape["C20"], np.tile((2 * np.pi) ** 2 * (0.1 + 0.05 * s), (25, 1)), rtol=0.02)
            body.material(**shape)
        else:
            body.material(L10=0.5, L01=0.9)
        body.step(500)
        moved[kept] = np.linalg.norm(body.tube() - tube, axis=2).max()
    assert moved[True] < 0.01 < 0.03 < moved[False]


def test_a_slit_tube_springs_open():
    """Half the curvature of its rings, the same lengths, and weights 0 along a meridian: half a circle of twice the radius.

    The gap is one edge wide around, the whole tube long, and nowhere else.
    """
    nx, r = 25, 0.1
    node, edge = np.ones((nx, 1)), np.ones((nx, 1))
    node[[0, -1]] = edge[-1] = 0
    body = _body(w20=1e-3 * node, C20=2 * np.pi**2 * r, k10=0.1 * edge, L10=2 * np.pi * r, b=0.0, d=0.0, reaction=0.0)
    body.step(3000)
    for ring in body.tube().transpose(1, 0, 2):
        sides = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1) * nx
        np.testing.assert_allclose(sides[:-1], 2 * np.pi * r, rtol=0.01)
        np.testing.assert_allclose(_turning(ring)[0] * nx, np.pi, rtol=0.02)  # the angle of 2 pi r on radius 2 r
        np.testing.assert_allclose(sides[-1] / nx, 4 * r * np.sin(np.pi / 2 * 24 / 25), rtol=0.02)


def test_meridians_take_their_natural_curvature():
    """C02 bulges a tube into a barrel: each meridian turns by C02 over a length of 1."""
    body = _body(w02=1e-3, C02=0.8, w20=1e-9, k01=1.0, L01=1.0, b=1.0, w2=0.0, d=0.0)
    body.step(3000)
    tube = body.tube()
    radius = np.linalg.norm(tube - body.spine(), axis=2).mean(axis=0)
    angles, _ = _turning(tube[3])
    np.testing.assert_allclose(angles[2:-2] * 24, 0.8, rtol=0.05)
    assert radius[12] > radius[[0, -1]].max() + 0.05


def test_a_length_of_zero_shuts_the_tube():
    """The paper: with the circumferential metric at zero the tube contracts round its spine."""
    body = _body(k10=0.1, L10=0.0)
    body.step(400)
    assert np.linalg.norm(body.tube() - body.spine(), axis=2).max() < 0.02
