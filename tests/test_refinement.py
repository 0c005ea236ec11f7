"""Equilibria of a tube with couplings under smooth loads: the same by every scheme, and of second order in the grid."""

from itertools import pairwise

import numpy as np
import pytest

from symseek.sim.solvers import make_solver
from tests import reference
from tests.rig import Rig

HOLD = 0.3
WEIGHTS = {
    "w10": 1e-3, "w20": 2e-5, "w11": 1e-7, "w01": 1e-3, "w02": 1e-5, "w1": 1e-2, "w2": 1e-4,
    "a": 1.0, "reaction": 0.3, "b": 0.5, "c": 0.02,
}  # fmt: skip


def _load(n):
    """Where springs of even stiffness draw each node: a bent, wavy tube of uneven sections, smooth in x and s."""
    angle, s = np.meshgrid(2 * np.pi * np.arange(n) / n, np.linspace(0, 1, n))
    radius = 0.15 + 0.03 * np.cos(4 * s) + 0.015 * np.cos(3 * angle) * np.sin(2 * s) + 0.02 * np.cos(2 * angle)
    axis = np.stack([0.08 * np.sin(3 * s), s, 0.05 * np.cos(2 * s)], -1)
    return axis + radius[..., None] * np.stack([np.cos(angle), 0.15 * np.sin(angle + 3 * s), -np.sin(angle)], -1)


def _rest(n, scheme, iterations, slow=None, **more):
    """Tube and spine at rest, from a cylinder."""
    angle, s = 2 * np.pi * np.arange(n) / n, np.linspace(0, 1, n)
    spine = np.stack([0 * s, s, 0 * s], -1)
    ring = 0.15 * np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], -1)
    rig, load = Rig((spine[:, None] + ring, spine), **WEIGHTS, **more), _load(n)
    solver = make_solver(scheme, rig.model, None, slow, 0.8)
    mass = reference.end_mass(n)[:, None, None]
    for _ in range(iterations):
        force = rig.forces()[0] + HOLD * mass * (load - rig.tube())
        rig.state.force.assign(force.reshape(-1, 3).astype(np.float32))
        solver.step(rig.state)
    return rig.tube(), rig.spine()


def test_one_equilibrium_whatever_the_scheme():
    """All five within 1e-3 of the length; by far, since rest is R = 0 for all."""
    exact = _rest(17, "direct", 200, d=0.05)
    assert np.abs(exact[0] - _load(17)).max() > 0.02  # the forces of the model matter
    for scheme, iterations, slow in (
        ("adi", 200, None), ("jacobi", 1000, None), ("sor", 800, None), ("sor", 1500, 1.0), ("euler", 3000, None),
    ):  # fmt: skip
        for found, true in zip(_rest(17, scheme, iterations, slow, d=0.05), exact, strict=True):
            np.testing.assert_allclose(found, true, atol=2e-5, err_msg=f"{scheme} {slow}")


@pytest.fixture(scope="module", params=[0.0, 0.05], ids=["the paper's forces", "upright rings"])
def rests(request):
    """At 17, 33, 65 and 129 nodes either way, (tube, spine) at the places of the coarsest grid: 17 along, 16 angles.

    Tension draws the spine's ends together, where tangents have no length to tell them.
    """
    found = []
    for n in (17, 33, 65, 129):
        tube, spine = _rest(n, "adi", 250, d=request.param)
        # rings are smooth and periodic, so that their Fourier series tells them between nodes
        series = np.fft.rfft(tube[:: (n - 1) // 16], axis=1) / n
        order = np.arange(series.shape[1])
        wave = np.exp(2j * np.pi * np.outer(order, np.arange(16) / 16)) * np.where(order == 0, 1, 2)[:, None]
        found.append((np.einsum("skc,kx->sxc", series, wave).real, spine[:: (n - 1) // 16]))
    return found


@pytest.mark.parametrize("part", [0, 1], ids=["tube", "spine"])
def test_equilibria_are_of_second_order_in_the_grid(rests, part):
    """Differences between neighbouring grids fall as n^-2 under (4), (5), (7)-(9) and ours, from each pair to the next."""
    errors = [np.sqrt(((a[part] - b[part]) ** 2).sum(-1).mean()) for a, b in pairwise(rests)]
    assert min(np.log2(coarse / fine) for coarse, fine in pairwise(errors)) >= 1.8
    assert errors[-1] < 1e-4
