"""Rings dealt out anew: on the same surface, closer where meridians turn; how far rings look along the spine."""

import numpy as np

from symseek.sim.initial import STEADY, deal, fading
from tests.rig import circles, even_spine

NX, NS = 12, 25


def _tube(place, radius):
    """Tube (NX, NS, 3) and spine (NS, 3) of circles along Y, shut at the ends."""
    spine = np.column_stack([np.zeros(NS), place, np.zeros(NS)])
    return circles(spine, radius, NX).transpose(1, 0, 2), spine


def _drum():
    """Radius 0.2, length 1, flat ends; rings even along the meridian."""
    along = np.linspace(0, 1.4, NS)
    return _tube(np.clip(along - 0.2, 0, 1), np.minimum(np.minimum(along, 1.4 - along), 0.2))


def test_dealt_rings_lie_on_the_same_surface():
    angle = np.linspace(0, np.pi, NS) + 0.1 * np.sin(2 * np.linspace(0, np.pi, NS))
    tube, spine = _tube(0.5 - 0.5 * np.cos(angle), 0.3 * np.sin(angle))
    dealt, axis = deal(tube, spine)
    on = (dealt[..., 1] - 0.5) ** 2 / 0.25 + (dealt[..., 0] ** 2 + dealt[..., 2] ** 2) / 0.09
    np.testing.assert_allclose(on, 1, atol=3e-3)
    np.testing.assert_allclose(dealt[:, [0, -1]], tube[:, [0, -1]], atol=1e-12)
    np.testing.assert_allclose(dealt.mean(axis=0), axis, atol=1e-3)


def test_rings_are_dealt_closer_at_a_rim():
    tube, spine = _drum()
    dealt, _ = deal(tube, spine)
    gap = np.linalg.norm(np.diff(dealt[0], axis=0), axis=1)
    middle = 0.5 * (dealt[0, 1:] + dealt[0, :-1])
    rim = np.linalg.norm(middle - [0.2, 0, 0], axis=1) < 0.04
    assert rim.any() and gap[rim].max() < 0.6 * np.median(gap)


def test_even_rings_of_a_straight_tube_stay():
    spine = even_spine(NS)
    tube = circles(spine, 0.1, NX).transpose(1, 0, 2)
    dealt, axis = deal(tube, spine)
    np.testing.assert_allclose(dealt, tube, atol=1e-9)
    np.testing.assert_allclose(axis, spine, atol=1e-9)


def test_tangents_look_as_far_as_the_tube_is_wide():
    """exp(-h / (STEADY r)) for a segment of length h on a tube of radius r; shut ends look as far as what reaches them."""
    radius = np.full(NS, 0.2)
    radius[[0, -1]] = 0
    tube, spine = _tube(np.linspace(0, 1, NS), radius)
    np.testing.assert_allclose(fading(tube, spine), np.exp(-1 / (NS - 1) / (STEADY * 0.2)), rtol=1e-9)
