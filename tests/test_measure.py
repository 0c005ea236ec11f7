"""Measures of a finished tube on closed forms; support of a contour by an edge of known place."""

import dataclasses

import numpy as np
import pytest

from symseek.scenes.synthetic import make
from symseek.sim.camera import Camera
from symseek.sim.foreground import Foreground
from symseek.sim.hidden import Hidden
from symseek.sim.measure import (
    Support,
    arc_length,
    contour_support,
    lengths,
    map_agreement,
    shape_measures,
    share_of,
    support_measures,
)
from symseek.sim.potential import Potential
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.reconstruct import reconstruct


def _ellipsoid(nx=25, ns=25, along=2.0, across=0.7):
    """Tube (nx, ns, 3) with poles, its spine, and the angle of each ring."""
    angle, turn = np.linspace(0, np.pi, ns), 2 * np.pi * np.arange(nx)[:, None] / nx
    radius = across * np.sin(angle)
    radius[[0, -1]] = 0
    axis = -along * np.cos(angle)
    tube = np.stack([radius * np.cos(turn), np.broadcast_to(axis, (nx, ns)), -radius * np.sin(turn)], -1)
    return tube, np.stack([0 * axis, axis, 0 * axis], -1), angle


def test_ellipsoid():
    tube, spine, angle = _ellipsoid()
    m = shape_measures(tube, spine)
    assert m["length"] == pytest.approx(4)
    np.testing.assert_allclose(m["station"], 2 * (1 - np.cos(angle)), atol=1e-6)
    np.testing.assert_allclose(m["radius"], 0.7 * np.sin(angle), atol=1e-12)
    assert m["volume"] == pytest.approx(4 / 3 * np.pi * 2 * 0.7**2, rel=2e-3)
    e = np.sqrt(1 - (0.7 / 2) ** 2)
    assert m["area"] == pytest.approx(2 * np.pi * 0.7**2 * (1 + 2 / (0.7 * e) * np.arcsin(e)), rel=2e-3)
    assert m["asymmetry"] == pytest.approx(0, abs=1e-12)


def test_measures_carry_units():
    """Ten times as large: length and radii by 10, area by 100, volume by 1000, asymmetry as it was."""
    tube, spine, _ = _ellipsoid()
    tube = tube * [1.1, 1, 1]
    one, ten = shape_measures(tube, spine), shape_measures(10 * tube, 10 * spine)
    for name, power in {"length": 1, "station": 1, "radius": 1, "area": 2, "volume": 3, "asymmetry": 0}.items():
        np.testing.assert_allclose(ten[name], 10.0**power * np.asarray(one[name]), rtol=1e-9, atol=1e-12)


def test_length_of_an_arc_from_uneven_nodes():
    """R phi, and each node's share of it; chords alone would lack 1e-3 of it. Repeated nodes add nothing."""
    angle = 1.5 * (np.linspace(0, 1, 15) - 0.08 * np.sin(2 * np.pi * np.linspace(0, 1, 15)))
    arc = 3.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    np.testing.assert_allclose(arc_length(arc), 3 * angle, atol=3e-4)
    twice = np.concatenate([arc[:5], arc[4:]])
    np.testing.assert_allclose(arc_length(twice)[-1], 4.5, atol=3e-4)


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_asymmetry_of_an_oval_tube(share):
    """|r| = R (1 + e cos 2 theta): root mean square of |r| / rbar - 1 is e / sqrt 2, up to its square."""
    turn = 2 * np.pi * np.arange(48) / 48
    radius = 1 + share * np.cos(2 * turn)
    ring = np.stack([radius * np.cos(turn), 0 * turn, -radius * np.sin(turn)], -1)
    spine = np.linspace(0, 5, 11)[:, None] * np.array([0, 1, 0])
    asymmetry = shape_measures(ring[:, None] * np.linspace(0.5, 1, 11)[:, None] + spine, spine)["asymmetry"]
    assert asymmetry == pytest.approx(share / np.sqrt(2), rel=2 * share)


STEP, ORIGIN, HALF = 1.5, (-10.0, 20.0), 60.0


def _edge(column, last_row):
    """P of a vertical edge at an image column, in rows before `last_row` only."""
    x = ORIGIN[0] + STEP * np.arange(120)
    y = ORIGIN[1] + STEP * np.arange(100)
    p = np.exp(-0.5 * ((x - column) / 3) ** 2) * (y[:, None] < last_row)
    return Potential(sigma=3.0, samples=np.zeros((*p.shape, 4), np.float32), magnitude=p, step=STEP, origin=ORIGIN)


def _contour(column):
    """Forty points down a column, normals to the right."""
    points = np.stack([np.full(40, column), np.linspace(40, 150, 40)], -1)
    return points, np.tile([1.0, 0.0], (40, 1))


@pytest.mark.parametrize("ahead", [-2.0, 0.3, 1.7])
def test_offset_to_an_edge_beside_the_contour(ahead):
    """Whatever the place of either between the samples."""
    for column in np.linspace(60, 60 + STEP, 5):
        support = contour_support(*_contour(column), _edge(column + ahead, 1e9), np.zeros((0, 0)), HALF)
        np.testing.assert_allclose(support.offset, ahead, atol=0.05)
        assert support.supported.all()


def test_support_ends_where_the_edge_does():
    """Edge down to row 100, then nothing: points clear of its end say so."""
    points, normals = _contour(60.0)
    supported = contour_support(points, normals, _edge(60.0, 100.0), np.zeros((0, 0)), HALF).supported
    assert supported[points[:, 1] < 97].all() and not supported[points[:, 1] > 103].any()


def test_an_edge_too_far_off_is_no_support():
    support = contour_support(*_contour(60.0), _edge(66.0, 1e9), np.zeros((0, 0)), HALF)
    np.testing.assert_allclose(support.offset, 6.0, atol=0.05)
    assert not support.supported.any()


def test_the_map_must_fall_across_the_contour():
    """An edge with the object on both sides, or on the far side, is not its outline."""
    potential = _edge(60.0, 1e9)
    left = np.tile(ORIGIN[0] + STEP * np.arange(120) < 60.0, (100, 1)).astype(float)
    for inside, expected in ((left, True), (1 - left, False), (np.ones_like(left), False)):
        supported = contour_support(*_contour(60.0), potential, inside, HALF).supported
        assert np.all(supported == expected)


def _map_beside(shift, unsure=0.0, step=0.02):
    """The ellipsoid's outline in a map, `shift` to the right; `unsure` beyond the surely inside [half widths]."""
    y, x = np.mgrid[-2.5:2.5:step, -1.5:1.5:step]
    off = np.hypot((x - shift) / 0.7, y / 2)
    inside = np.clip(0.5 + (1 - off) / max(unsure, 1e-9), 0, 1).astype(np.float32)
    return Foreground(inside, step, (-1.5, -2.5), 4.0, 0.7, np.zeros((2, 2)))


def test_agreement_with_a_map_moved_aside():
    """An ellipse moved by d of its half width: intersection (2 / pi) (acos q - q sqrt(1 - q^2)) of it, q = d / 2."""
    tube = _ellipsoid()[0]
    assert map_agreement(tube, Camera.orthographic(), _map_beside(0.0))[0] > 0.995
    for share in (0.2, 0.5):
        q = share / 2
        both = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q * q))
        found = map_agreement(tube, Camera.orthographic(), _map_beside(0.7 * share))[0]
        # a sample of 1 / 35 half width to each side is let pass
        assert both / (2 - both) < found < both / (2 - both) + 0.05


def test_agreement_of_two_pieces_beside_something_else():
    """What lies apart in the map, after the object in its order of rows or before, is no part of a tube with a gap."""
    tube, cuts = _ellipsoid()[0], [(12, True)]
    for place in (slice(0, 5), slice(-5, None)):
        map_ = _map_beside(0.0)
        alone = map_agreement(tube, Camera.orthographic(), map_, cuts)[0]
        map_.inside[place, :5] = 1.0
        assert map_agreement(tube, Camera.orthographic(), map_, cuts)[0] == alone > 0.9


def test_what_the_map_has_where_others_lie_is_theirs():
    """A limb joined to another of the same colour: the map goes on over both, surely or not."""
    tube, camera = _ellipsoid()[0], Camera.orthographic()
    map_ = _map_beside(0.0)
    alone = map_agreement(tube, camera, map_)
    where = np.zeros(map_.inside.shape, bool)
    where[90:160, 75:] = True
    others = Hidden(where, (0, 0))
    # the mask's pixels are the map's samples
    sampled = dataclasses.replace(map_, step=1.0, origin=(0.0, 0.0))
    place = Camera(np.diag([1 / 0.02, 1 / 0.02, 1.0]) @ np.array([[1, 0, 0, 1.5], [0, 1, 0, 2.5], [0, 0, 0, 1.0]]))
    assert map_agreement(tube, place, sampled) == pytest.approx(alone, abs=1e-3)
    for value in (1.0, 0.6, 0.4):
        spilled = dataclasses.replace(sampled, inside=np.where(where, np.maximum(map_.inside, value), map_.inside))
        with_, without = (map_agreement(tube, place, spilled, others=o) for o in (others, None))
        assert with_ == pytest.approx(alone, abs=0.02)
        assert min(without) < 0.9
    # what is the tube's own stays so: others excuse no tube that lies beside its object
    moved = tube + np.array([0.3, 0, 0])
    assert map_agreement(moved, place, sampled, others=Hidden(~where, (0, 0)))[0] < 0.9


@pytest.mark.parametrize("unsure", [0.1, 0.5])
def test_certainty_of_a_soft_map(unsure):
    """Surely inside within 1 - 0.4 `unsure` of the outline, maybe within 1 + 0.4 `unsure`."""
    certainty = map_agreement(_ellipsoid()[0], Camera.orthographic(), _map_beside(0.0, unsure))[1]
    assert certainty == pytest.approx(((1 - 0.4 * unsure) / (1 + 0.4 * unsure)) ** 2, abs=0.01)


def test_a_run_cut_short_is_trusted_once_it_hardly_moves():
    """A pear after 20 iterations, on its way, and after 150: not at rest by the residual, but as large as the truth."""
    sample = make(35)
    early, late = (
        reconstruct([View(sample.image)], [Tube(sample.clicks)], Settings(iterations=n)).objects[0] for n in (20, 150)
    )
    assert not early.converged and any("not at rest" in w for w in early.warnings)
    assert not late.converged and late.trusted
    assert late.measures["volume"] == pytest.approx(sample.volume, rel=0.02)


def test_shares_of_a_contour_go_by_its_length():
    """A straight line of 10 px whose second half has ten times as many points: each half counts as a half."""
    column = np.concatenate([np.linspace(0, 5, 11), np.linspace(5, 10, 101)[1:]])
    points = np.column_stack([column, np.zeros(len(column))])
    length = lengths(points)
    assert length.sum() == pytest.approx(10)
    assert share_of(column > 5, length) == pytest.approx(0.5, abs=0.03)
    found = support_measures([Support(column <= 5, np.zeros(len(column)), length)], [column > 7.5])
    assert found["hidden_share"] == pytest.approx(0.25, abs=0.01)
    assert found["supported_share"] == pytest.approx(5 / 7.5, abs=0.04)
    assert share_of(np.zeros(0, bool), np.zeros(0)) == 0
