"""Coupling of tube and spine: (7)-(9) by their formulas, momentum and symmetry; our own forces as gradients of energies."""

import numpy as np
import pytest

from symseek.kernels import coupling
from symseek.sim.camera import Camera
from tests import reference
from tests.rig import Rig, circles, even_spine

RNG = np.random.default_rng(2)
NX, NS = 8, 9
MASS = reference.end_mass(NS)[:, None, None]
SPINE = (even_spine(NS) + 0.03 * RNG.normal(size=(NS, 3))).astype(np.float32).astype(float)
TUBE = circles(SPINE, 0.3, NX) + 0.06 * RNG.normal(size=(NS, NX, 3))
TUBE = TUBE.astype(np.float32).astype(float)
OFFSET = TUBE - SPINE[:, None]
LENGTH = np.linalg.norm(OFFSET, axis=-1, keepdims=True)
CENTROID, RADIUS = reference.ring_means(TUBE, SPINE)
FAR = np.linspace(0.2, 0.9, NS)
"""Fading of each ring's look along the spine."""
LOOK = FAR[:, None] ** np.arange(int(coupling.WINDOW))
D = np.linspace(0.4, 0.9, NS)
"""Strength of upright rings, not even."""
ATOL = 2e-6
"""A few roundings of float32 on numbers of order one."""


def _closed(tube):
    """The tube with each end ring drawn together to its mean."""
    out = tube.copy()
    for end in (0, -1):
        out[end] = out[end].mean(axis=0)
    return out


def test_ring_means():
    """Centroid and mean radius of figure 7, mean distance to the next ring, tangent over several segments."""
    rig = Rig((TUBE, SPINE), ring_far=LOOK)
    rig.forces()
    s = rig.state
    np.testing.assert_allclose(s.centroid.numpy(), CENTROID, atol=ATOL)
    np.testing.assert_allclose(s.radius.numpy(), RADIUS, atol=ATOL)
    gap = np.linalg.norm(np.diff(TUBE, axis=0), axis=-1).mean(axis=1)
    np.testing.assert_allclose(s.gap.numpy(), [*gap, 0], atol=ATOL)
    tangent = reference.tangents(SPINE, int(coupling.WINDOW), FAR)
    np.testing.assert_allclose(s.tangent.numpy(), tangent, atol=ATOL)


def test_means_of_a_closed_end_are_its_point():
    tube = _closed(TUBE)
    rig = Rig((tube, SPINE), closed=True)
    rig.forces()
    np.testing.assert_allclose(rig.state.centroid.numpy()[[0, -1]], tube[[0, -1], 0], atol=ATOL)
    distance = np.linalg.norm(tube[[0, -1], 0] - SPINE[[0, -1]], axis=1)
    np.testing.assert_allclose(rig.state.radius.numpy()[[0, -1]], distance, atol=ATOL)


@pytest.mark.parametrize("closed", [False, True])
def test_7_draws_spine_and_ring_together_without_net_force(closed):
    """a (vbar - v) on the spine; on the tube, per unit of x, the opposite."""
    tube = _closed(TUBE) if closed else TUBE
    a = RNG.uniform(0.5, 2, NS)
    force, spine_force = Rig((tube, SPINE), closed=closed, a=a, reaction=a).forces()
    expected = MASS[:, 0] * a[:, None] * (reference.ring_means(tube, SPINE)[0] - SPINE)
    np.testing.assert_allclose(spine_force, expected, atol=ATOL)
    np.testing.assert_allclose(force.mean(axis=1) + spine_force, 0, atol=ATOL)
    np.testing.assert_allclose(np.ptp(force, axis=1), 0, atol=ATOL)


def test_8_pulls_to_the_mean_radius():
    """b (rbar - |r|) r / |r|: nothing in it across r, nothing on the spine, nothing in all by length of ring."""
    b = RNG.uniform(0.5, 2, NS)
    force, spine_force = Rig((TUBE, SPINE), b=b).forces()
    expected = MASS * b[:, None, None] * (RADIUS[:, None, None] - LENGTH) * OFFSET / LENGTH
    np.testing.assert_allclose(force, expected, atol=ATOL)
    np.testing.assert_array_equal(spine_force, 0)


def test_8_leaves_circles_alone():
    tube = circles(even_spine(NS), np.linspace(0.1, 0.4, NS), NX)
    force, _ = Rig((tube, even_spine(NS)), b=1.0).forces()
    np.testing.assert_allclose(force, 0, atol=ATOL)


def test_9_blows_up_and_stays_regular_on_the_spine():
    """c r / |r|, and c r / (0.1 rbar) within a tenth of the mean radius."""
    tube = TUBE.copy()
    tube[4, 0] = SPINE[4] + [0.004, 0.003, 0]
    tube[5, 0] = SPINE[5]
    c = np.linspace(-1, 1.2, NS)
    force, _ = Rig((tube, SPINE), c=c).forces()
    radius = reference.ring_means(tube, SPINE)[1]
    r = tube - SPINE[:, None]
    reach = np.maximum(np.linalg.norm(r, axis=-1), 0.1 * radius[:, None])[..., None]
    np.testing.assert_allclose(force, MASS * c[:, None, None] * r / reach, atol=ATOL)


@pytest.mark.parametrize("radius", [0.02, 0.3, 2.0])
def test_balanced_tube_keeps_circles_of_any_radius(radius):
    """c_balance (w10 L + w20 L^2) cancels the contraction of (3), L = (2 n sin(pi / n))^2."""
    w10, w20, lap = 0.3, 0.01, (2 * NX * np.sin(np.pi / NX)) ** 2
    spine = even_spine(NS)
    tube = circles(spine, radius, NX, turn=0.3)
    force, _ = Rig((tube, spine), w10=w10, w20=w20, balance=w10 * lap + w20 * lap**2).forces()
    contraction = (w10 * lap + w20 * lap**2) * radius
    np.testing.assert_allclose(force, 0, atol=1e-5 * contraction)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("uneven", [False, True])
def test_balanced_rigidity_is_the_gradient_of_an_energy_that_ellipses_have_none_of(uneven, closed):
    """(1 - c_balance) of (3) and c_balance of (3) less the ring's first harmonic, here by its Fourier transform."""
    w20 = RNG.uniform(0.5, 2, (NS, 1)) + (RNG.uniform(-0.4, 3, (NS, NX)) if uneven else np.zeros((NS, NX)))
    free = RNG.uniform(0, 1.2, NS)
    tube = _closed(TUBE) if closed else TUBE
    push = {"free": free} if uneven else {"balance": free * w20[:, 0] * (2 * NX * np.sin(np.pi / NX)) ** 4}
    force, spine_force = Rig((tube, SPINE), closed=closed, w20=w20.ravel(), **push).forces()
    counts = np.array([0, *np.ones(NS - 2), 0]) if closed else MASS.ravel()

    def energy(v):
        waves = np.fft.fft(v, axis=1)
        waves[:, [1, -1]] = 0
        total = 0.0
        for share, line in ((1 - free, v), (free, np.fft.ifft(waves, axis=1).real)):
            bends = np.roll(line, -1, axis=1) - 2 * line + np.roll(line, 1, axis=1)
            total += np.sum((counts * share)[:, None, None] * w20[..., None] * bends**2) * NX**4 / 2
        return total

    expected = -reference.gradient(energy, tube, 1e-3)
    np.testing.assert_allclose(force, expected, atol=2e-6 * np.abs(expected).max())
    np.testing.assert_array_equal(spine_force, 0)


def test_a_balanced_ring_settles_however_its_rigidity_varies():
    """No direction in which forces grow: the linear map from nodes to minus their force has no negative value."""
    w20 = RNG.uniform(0, 1, NX) * (np.arange(NX) > 2)
    spine, size = even_spine(3), 3 * NX * 3
    columns = []
    for at in range(size):
        tube = np.zeros(size)
        tube[at] = 1.0
        columns.append(-Rig((tube.reshape(3, NX, 3), spine), w20=np.tile(w20, 3), free=1.0).forces()[0].ravel())
    push = -Rig((np.zeros((3, NX, 3)), spine), w20=np.tile(w20, 3), free=1.0).forces()[0].ravel()
    matrix = np.array(columns) - push
    values = np.linalg.eigvalsh(matrix)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5 * values[-1])
    assert values[0] > -1e-5 * values[-1]


def test_a_ring_too_thin_pushes_itself_open():
    """(least - rbar) outward on a circle below the least radius, nothing above it."""
    least = float(coupling.THINNEST)
    radius = least * np.linspace(0.25, 2.25, NS)
    tube = circles(even_spine(NS), radius, NX)
    force, _ = Rig((tube, even_spine(NS))).forces()
    outward = circles(0 * even_spine(NS), 1.0, NX)
    push = MASS * np.maximum(least - radius, 0)[:, None, None] * outward
    np.testing.assert_allclose(force, push, atol=2e-3 * least)


def test_closed_ends_feel_no_symmetry_expansion_or_ring_forces():
    force, _ = Rig(
        (_closed(TUBE), SPINE), closed=True, b=1.0, c=1.0, balance=1.0, free=1.0, d=1.0, w10=1.0, w20=1.0
    ).forces()
    np.testing.assert_array_equal(force[[0, -1]], 0)
    assert np.abs(force[1:-1]).min() > 0


def _upright(v, spine, centroid):
    """Sum over rings of mass d mean ((v - c).t)^2 / 2, centroids held; t is less than 1 where the spine vanishes."""
    t = reference.tangents(spine, int(coupling.WINDOW), FAR, float(coupling.SHORTEST))
    out = np.sum((v - centroid[:, None]) * t[:, None], axis=-1)
    return 0.5 * np.sum((D * reference.end_mass(len(v)))[:, None] * out**2) / v.shape[1]


@pytest.mark.parametrize("length", [1.0, 0.3], ids=["spine", "vanishing spine"])
@pytest.mark.parametrize("closed", [False, True])
def test_upright_rings_and_spine_share_one_energy(closed, length):
    tube = _closed(TUBE) if closed else TUBE
    spine = (length * SPINE).astype(np.float32).astype(float)
    centroid = reference.ring_means(tube, spine)[0]
    rig = Rig((tube, spine), closed=closed, d=D, ring_far=LOOK)
    force, spine_force = rig.forces()
    short = (rig.state.known.numpy() < 1).sum()
    assert short == 0 if length == 1 else 0 < short < NS
    gradient = reference.gradient(lambda v: _upright(v, spine, centroid), tube, 1e-5)
    np.testing.assert_allclose(force, -NX * gradient, atol=ATOL)
    gradient = reference.gradient(lambda v: _upright(tube, v, centroid), spine, 1e-5)
    np.testing.assert_allclose(spine_force, -gradient, atol=3 * ATOL)


def test_upright_force_gives_the_spine_no_net_push():
    """The energy knows differences of the spine alone."""
    _, spine_force = Rig((_closed(TUBE), SPINE), closed=True, d=0.7, ring_far=LOOK).forces()
    np.testing.assert_allclose(spine_force.sum(axis=0), 0, atol=ATOL)
    assert np.abs(spine_force).max() > 1e-3


def _centring(v):
    """At both ends mean (|e| - mean |e|)^2 / 4 over the meridians' first edges e."""
    lengths = np.linalg.norm(v[[0, -1]] - v[[1, -2]], axis=-1)
    return 0.25 * np.sum(lengths.var(axis=1))


def test_centring_of_poles_is_a_gradient():
    """A pole moves as one: its force is the mean over its nodes."""
    tube = _closed(TUBE)
    force, spine_force = Rig((tube, SPINE), closed=True, centre=0.8).forces()
    rest = reference.gradient(lambda v: _centring(np.concatenate([tube[:1], v, tube[-1:]])), tube[1:-1], 1e-5)
    np.testing.assert_allclose(force[1:-1], -0.8 * NX * rest, atol=ATOL)
    for end, other in ((0, -1), (-1, 0)):

        def energy(pole, end=end, other=other):
            moved = tube.copy()
            moved[end], moved[other] = pole, tube[other]
            return _centring(moved)

        expected = -0.8 * reference.gradient(energy, tube[end, 0], 1e-5)
        np.testing.assert_allclose(force[end].mean(axis=0), expected, atol=ATOL)
    np.testing.assert_array_equal(spine_force, 0)
    np.testing.assert_allclose(force.sum(axis=(0, 1)), 0, atol=NX * ATOL)


def test_a_pole_amid_a_round_cap_stays():
    tube = circles(even_spine(NS), [0, *np.full(NS - 2, 0.3), 0], NX)
    force, _ = Rig((tube, even_spine(NS)), closed=True, centre=1.0).forces()
    np.testing.assert_allclose(force.mean(axis=1), 0, atol=ATOL)


LENS = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
CAMERAS = {
    "orthographic": Camera.orthographic(0.5),
    "stereo": Camera.stereo(0.4),
    "perspective": Camera.perspective(LENS, np.eye(3), np.array([0.1, -0.2, 3.0])),
}


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_depth_is_held_along_the_line_of_sight(camera):
    """Spring of rings' centroids and of the spine towards a depth along i, or a distance from the focal point."""
    m = camera.matrix

    def depth(p):
        if camera.affine:
            ray = np.cross(m[0, :3], m[1, :3])  # both image rows are flat along it
            return p @ (ray / np.linalg.norm(ray))
        return np.linalg.norm(p + np.linalg.inv(m[:, :3]) @ m[:, 3], axis=-1)

    rest = depth(SPINE) + RNG.uniform(-0.2, 0.2, NS)
    force, spine_force = Rig((TUBE, SPINE), camera=camera, depth=0.6, depth_rest=rest).forces()

    def energy(p):
        return 0.3 * np.sum(reference.end_mass(NS) * (rest - depth(p)) ** 2)

    np.testing.assert_allclose(spine_force, -reference.gradient(energy, SPINE, 1e-5), atol=5 * ATOL)
    np.testing.assert_allclose(force.mean(axis=1), -reference.gradient(energy, CENTROID, 1e-5), atol=5 * ATOL)
    np.testing.assert_allclose(np.ptp(force, axis=1), 0, atol=ATOL)


@pytest.mark.parametrize("gap", [None, 4])
def test_nodes_keep_their_shares_of_the_meridians(gap):
    """Minus the gradient, per hx hs, of the mean of sum hold/2 (e - its share of the mean meridian)^2, in each piece."""
    hold = RNG.uniform(0.5, 2, (NS, NX))
    slack = (1 / hold).mean(axis=1)
    first, last = np.zeros(NS, int), np.full(NS, NS - 1)
    pieces = [(0, NS - 1)] if gap is None else [(0, gap), (gap + 1, NS - 1)]
    for a, b in pieces:
        first[a : b + 1], last[a : b + 1] = a, b
    springs = {"edge_hold": hold.ravel(), "ring_slack": slack, "ring_first": first, "ring_last": last}
    force, spine_force = Rig((TUBE, SPINE), **springs).forces()

    def energy(v):
        total = 0.0
        for a, b in pieces:
            edges = np.linalg.norm(np.diff(v[a : b + 1], axis=0), axis=2)
            rest = 1 / hold[a:b] / slack[a:b].sum() * edges.mean(axis=1).sum()
            total += (hold[a:b] / 2 * (edges - rest) ** 2).sum(axis=0).mean()
        return total

    np.testing.assert_allclose(force, -NX * (NS - 1) * reference.gradient(energy, TUBE), atol=1e-4)
    assert np.abs(force).max() > 0.1
    np.testing.assert_array_equal(spine_force, 0)
