"""The random walker against the minimum it stands for."""

import numpy as np
import pytest

from symseek.sim.walk import DECIDED, UNKNOWN, Walk

SHAPE = (18, 21)


def _scene():
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 1, (*SHAPE, 3))
    where = np.hypot(*(np.indices(SHAPE) - 9)) < 8
    hold = np.where(rng.uniform(size=SHAPE) < 0.1, 10.0, 0.01)
    return Walk.on(x, where, np.ones(SHAPE, bool)), where, hold, rng.uniform(0, 1, SHAPE), rng.uniform(0, 1, SHAPE)


@pytest.mark.parametrize("again", [False, True])
def test_the_gradient_of_the_energy_vanishes(again):
    """Twice sum over pairs w (x_i - x_j) + hold (x - prior) at each sample, the pairs one by one."""
    walk, where, hold, prior, start = _scene()
    inside = walk.solve(hold, prior, start, again)
    assert np.all(inside[~where] == 0)
    x, s = inside[where], start[where]
    gradient = (hold * (inside - prior))[where]
    for i, j, w in zip(walk.first, walk.second, walk.weight, strict=True):
        pull = w * (x[i] - x[j]) / (max(1.0, abs(s[i] - s[j]) / DECIDED) if again else 1.0)
        gradient[i] += pull
        gradient[j] -= pull
    assert np.linalg.norm(gradient) < 1e-3 * np.linalg.norm((hold * prior)[where])


def test_ties_through_what_is_not_known_are_weak():
    x, where = np.random.default_rng(3).uniform(0, 1, (*SHAPE, 3)), np.ones(SHAPE, bool)
    known = np.indices(SHAPE)[0] < 9
    one, other = Walk.on(x, where, where), Walk.on(x, where, known)
    both = known.ravel()[one.first] & known.ravel()[one.second]
    np.testing.assert_allclose(other.weight, np.where(both, one.weight, UNKNOWN * one.weight))
