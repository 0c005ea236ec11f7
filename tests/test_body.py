"""Bodies without an image, by every scheme, at rest and with mass, and materials that change under a captured step."""

import numpy as np
import pytest

from symseek.sim.body import Body
from symseek.sim.material import Material
from symseek.sim.problem import Settings, Tube
from symseek.sim.solvers import SCHEMES

GRID = (12, 11)
AXIS = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
schemes = pytest.mark.parametrize("scheme", SCHEMES)


def _body(scheme, closed=False, step=None, **weights):
    return Body(
        [Tube(AXIS, radius=0.15, grid=GRID, material=Material(reaction=1.0, closed=closed, **weights))],
        Settings(scheme=scheme, step=step),
    )


@schemes
def test_every_scheme_rests_at_natural_lengths(scheme):
    """Circumference L10 of rings against (8) alone, which circles leave at 0: polygons of perimeter L10."""
    body = _body(scheme, w20=0.0, w02=1e-6, c_balance=0.0, k10=0.02, L10=1.2)
    for _ in range(300):
        body.step(20)
        if np.abs(_perimeters(body) - 1.2).max() < 2e-3:
            break
    np.testing.assert_allclose(_perimeters(body), 1.2, atol=2e-3)


def _perimeters(body):
    tube = body.tube()
    return np.linalg.norm(np.roll(tube, -1, axis=0) - tube, axis=2).sum(axis=0)


def test_mass_and_viscosity_are_fields():
    """A spine's node has the mean of its ring's; a mass that varies round a ring takes the direct solver."""
    mu = np.random.default_rng(6).uniform(0.05, 0.1, GRID)
    body = _body("auto", mu=mu.tolist(), gamma=[1.0, 2.0])
    model = body._fabric.model
    np.testing.assert_allclose(model.mu.numpy().reshape(GRID[1], GRID[0]), mu.T, rtol=1e-6)
    np.testing.assert_allclose(model.spine_mu.numpy(), mu.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(model.spine_gamma.numpy(), np.linspace(1, 2, GRID[1]), rtol=1e-6)
    assert body._loop.solver.name == "direct"


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("change", [{"w20": 3e-4}, {"w11": 2e-6}, {"w01": 0.02}, {"gamma": 2.0}, {"mu": 0.05}, {"a": 0.5}])
@schemes
def test_a_change_on_the_way_is_a_material_from_the_start(scheme, change, closed):
    """To the bit: whatever a graph and factors hold of the material before is made anew."""
    if "mu" in change and not SCHEMES[scheme].bears_mass:
        body = _body(scheme)
        body.material(**change)
        with pytest.raises(ValueError, match=r"does not integrate material\.mu"):
            body.step()
        return
    changed, fresh = _body(scheme, closed), _body(scheme, closed, **change)
    tube, spine = changed.tube(), changed.spine()
    tube = tube + 0.01 * np.random.default_rng(5).normal(size=(1, GRID[1], 3))
    changed.step(5)
    changed.material(**change)
    for body in (changed, fresh):
        body.place(tube, spine)
        body.step(5)
    np.testing.assert_array_equal(changed.tube(), fresh.tube())
    np.testing.assert_array_equal(changed.spine(), fresh.spine())
    assert np.abs(changed.tube() - tube).max() > 1e-5


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if SCHEMES[s].bears_mass])
def test_with_mass_a_stretched_ring_swings_and_comes_to_rest(scheme):
    """Damped: past its natural length, which it ends at; the velocity is the way over the time."""
    body = _body(scheme, w20=0.0, w02=1e-6, c_balance=0.0, k10=0.02, L10=1.2, mu=0.05, gamma=0.05, step=0.05)
    seen = []
    while body.time < 20.0:
        tube, time = body.tube(), body.time
        body.step()
        seen.append(_perimeters(body)[5])
        if len(seen) % 100 == 3:
            np.testing.assert_allclose(body.velocity(), (body.tube() - tube) / (body.time - time), atol=2e-4)
    assert max(seen) > 1.21
    assert abs(seen[-1] - 1.2) < 5e-4


@schemes
def test_a_tube_without_rigidity_in_places_stays_as_wide_as_it_is(scheme):
    """With nothing to draw it the balanced tube has no reason to grow or shrink; a patch and a meridian have no w20."""
    w20 = np.full(GRID, 1e-4)
    w20[3:6, 2:4] = w20[8] = 0.0
    body = _body(scheme, w20=w20.tolist(), w02=1e-6)
    for _ in range(20):
        body.step(50)
    np.testing.assert_allclose(_perimeters(body)[1:-1], 2 * GRID[0] * 0.15 * np.sin(np.pi / GRID[0]), rtol=0.02)
