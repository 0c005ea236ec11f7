"""Springs and volcanoes against differences of their energies, implicit against a direct solution, when they hold."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import symseek
from symseek import cli
from symseek.kernels import spring as kernels
from symseek.sim.assembly import Assembly, maps_of
from symseek.sim.body import Body
from symseek.sim.camera import Camera
from symseek.sim.curve import evenly
from symseek.sim.problem import Tube
from symseek.sim.reconstruct import reconstruct
from symseek.sim.relax import Relaxation
from symseek.sim.spring import Held, Spring, Springs, most_at_once
from tests import reference
from tests.rig import Rig, circles, even_spine

RNG = np.random.default_rng(3)
NX, NS = 8, 6
SPINE = even_spine(NS)
TUBE = circles(SPINE, 0.3, NX) + 0.05 * RNG.normal(size=(NS, NX, 3))
DENSITY = NX * (NS - 1)
UNIT, ORIGIN = 40.0, np.array([100.0, 60.0, 0.0])
CAMERAS = {
    "orthographic": Camera.orthographic(1.0),
    "stereo": Camera.stereo(0.3, 1.0),
    "perspective": Camera.perspective(
        np.array([[300.0, 0, 50], [0, 320, 40], [0, 0, 1]]), np.eye(3), np.array([0, 0, 300.0])
    ),
}


def _springs(camera: Camera, *springs: Spring) -> tuple[Rig, Springs]:
    own = camera.in_units(UNIT, ORIGIN)
    rig = Rig((TUBE, SPINE), camera=own)
    body = Held(list(springs), 0, (NX, NS), True, (1 / NX, 1 / (NS - 1)), UNIT, ORIGIN, own, 0)
    held = Springs([body], np.repeat(reference.end_mass(NS), NX), "cpu")
    held.set(0, rig.state.tube.numpy())
    return rig, held


def _force(rig: Rig, held: Springs) -> np.ndarray:
    rig.state.force.zero_()
    held.add_forces(rig.model.eyes, rig.state.tube, rig.state.force)
    return rig.state.force.numpy().astype(float).reshape(NS, NX, 3)


def _point(v: np.ndarray, x: float, s: float) -> np.ndarray:
    """Bilinear between nodes, periodic in x."""
    i, j = int(x * NX), min(int(s * (NS - 1)), NS - 2)
    u, t = x * NX - i, s * (NS - 1) - j
    k = (i + 1) % NX
    return (1 - t) * ((1 - u) * v[j, i] + u * v[j, k]) + t * ((1 - u) * v[j + 1, i] + u * v[j + 1, k])


@pytest.mark.parametrize("material", [(0.3, 0.45), (0.95, 0.0), (0.5, 1.0)])
def test_spring_is_minus_the_gradient_of_its_energy(material):
    """k/2 |anchor - v|^2 at a point between nodes; as a load per hx hs."""
    anchor = (130.0, 40.0, 15.0)
    rig, held = _springs(CAMERAS["orthographic"], Spring(anchor, point=material, stiffness=3.0))
    a = (np.array(anchor) - ORIGIN) / UNIT

    def energy(v):
        return 1.5 * np.sum((a - _point(v, *material)) ** 2)

    expected = -DENSITY * reference.gradient(energy, rig.tube())
    np.testing.assert_allclose(_force(rig, held), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["orthographic", "stereo"])
def test_spring_to_an_image_point_pulls_in_the_image_alone(name):
    """k/2 |lift of the gap|^2, which in an affine view is the gradient of an energy; nothing along the line of sight."""
    camera = CAMERAS[name]
    rig, held = _springs(camera, Spring((120.0, 30.0), point=(0.3, 0.45), stiffness=2.0))
    own = camera.in_units(UNIT, ORIGIN)
    rows = own.matrix[:2, :3]

    def energy(v):
        gap = np.array([120.0, 30.0]) - own.project(_point(v, 0.3, 0.45))
        return float(gap @ np.linalg.inv(rows @ rows.T) @ gap)

    expected = -DENSITY * reference.gradient(energy, rig.tube())
    force = _force(rig, held)
    np.testing.assert_allclose(force, expected, atol=2e-5 * np.abs(expected).max())
    np.testing.assert_allclose(force @ own.sight(np.zeros(3)), 0, atol=1e-5 * np.abs(expected).max())


def test_spring_in_a_perspective_view_leads_to_the_anchor():
    own = CAMERAS["perspective"].in_units(UNIT, ORIGIN)
    at = own.project(_point(TUBE, 0.3, 0.45))
    rig, held = _springs(CAMERAS["perspective"], Spring((at[0] + 1.0, at[1] - 2.0), point=(0.3, 0.45)))
    way = _force(rig, held).sum(axis=(0, 1)) / DENSITY
    np.testing.assert_allclose(own.project(_point(TUBE, 0.3, 0.45) + way) - at, [1, -2], atol=0.02)


@pytest.mark.parametrize("anchor", [(105.0, 85.0, 5.0), (105.0, 85.0)])
def test_volcano_is_minus_the_gradient_of_its_energy(anchor):
    """k R^2 / 2 / (1 + r^2/R^2), per unit of material over the whole object; r in the image for an image point."""
    reach = 12.0
    rig, held = _springs(CAMERAS["orthographic"], Spring(anchor, stiffness=0.7, reach=reach))
    a, r0 = (np.array(anchor) - ORIGIN[: len(anchor)]) / UNIT, reach / UNIT
    mass = reference.end_mass(NS)[:, None]

    def energy(v):
        r2 = np.sum((v[..., : len(anchor)] - a) ** 2, axis=-1)
        return 0.35 * r0**2 * np.sum(mass / (1 + r2 / r0**2))

    expected = -reference.gradient(energy, rig.tube(), 1e-5)
    np.testing.assert_allclose(_force(rig, held), expected, atol=1e-4 * np.abs(expected).max())
    away = np.sum((rig.tube() - [*a, 0][:3])[..., :2] * expected[..., :2], axis=-1)
    assert away.min() >= -1e-9


def test_springs_that_are_taken_implicitly_solve_the_whole_matrix():
    """(P + sum k B B')^-1 R from a step P^-1 R, two springs at neighbouring points and a volcano beside them."""
    soft, stiff = (Spring((0.0, 0.0, 0.0), (0.3, s), stiffness=k) for s, k in ((0.45, 5.0), (0.5, 800.0)))
    springs = [soft, stiff, Spring((5.0, 0.0, 0.0), reach=3.0)]
    _, held = _springs(CAMERAS["orthographic"], *springs)
    n = NX * NS
    root = RNG.normal(size=(n, n))
    p = root @ root.T / n + np.eye(n)
    held.take_implicitly(lambda load: np.linalg.solve(p, load))
    residual = RNG.normal(size=(n, 3))
    step = np.linalg.solve(p, residual)
    nodes, velocity = (wp.array(v.astype(np.float32), dtype=wp.vec3) for v in (TUBE.reshape(-1, 3) + step, step))
    held.give_back(nodes, velocity)
    for spring in springs[:2]:
        assert spring.point is not None
        b = np.array([_point(row.reshape(NS, NX), *spring.point) for row in np.eye(n)])
        p = p + spring.stiffness * DENSITY * np.outer(b, b)
    expected = np.linalg.solve(p, residual)
    np.testing.assert_allclose(velocity.numpy(), expected, atol=2e-5 * np.abs(step).max())
    np.testing.assert_allclose(nodes.numpy(), TUBE.reshape(-1, 3) + expected, atol=1e-5)


def test_when_springs_hold():
    """In force from `start` to before `stop`, tied to what is nearest when it takes hold; says what is to come."""
    late = Spring((100.0, 60.0, 0.0), near=(*(UNIT * TUBE[2, 3] + ORIGIN),), start=5, stop=9)
    rig, held = _springs(CAMERAS["orthographic"], late)
    assert [i for i in range(12) if held.due(i)] == [5, 9]
    assert [i for i in range(12) if held.lets_go(i)] == [9]
    assert held.pending(9) and not held.pending(10)
    assert not _force(rig, held).any() and not held.holding(0)
    held.set(5, rig.state.tube.numpy())
    force = _force(rig, held)
    assert np.argwhere(force.any(axis=-1)).tolist() == [[2, 3]]
    np.testing.assert_allclose(force[2, 3], -DENSITY * TUBE[2, 3], rtol=1e-5)
    held.set(9, rig.state.tube.numpy())
    assert not _force(rig, held).any()


def test_nearest_in_the_image_is_on_the_near_side():
    """A front and a back node of a tube project to the same point, the back one first: the front one is tied."""
    own = CAMERAS["orthographic"].in_units(UNIT, ORIGIN)
    tube = circles(SPINE, 0.3, NX, turn=np.pi)
    back, front = np.argmax(tube[3, :, 2]), np.argmin(tube[3, :, 2])
    assert back < front
    place = tuple(own.project(tube[3, back]))
    body = Held([Spring((0.0, 0.0), near=place)], 0, (NX, NS), True, (1 / NX, 1 / (NS - 1)), UNIT, ORIGIN, own, 0)
    held = Springs([body], np.ones(NX * NS), "cpu")
    held.set(0, tube.reshape(-1, 3))
    assert held.tied[0] == ([3 * NX + front] * 4, [1.0, 0.0, 0.0, 0.0])


def test_a_spring_pulls_a_tube_and_lets_go():
    """Off its outline by 25 px and held there; free again, the outline is where it was."""
    scene = symseek.load(cli.demos()["squash"])
    rest = reconstruct(scene.views, scene.tubes, scene.settings).objects[0]
    edge = rest.contour[0][rest.contour[0][:, 1].argmin()]
    spring = Spring((edge[0], edge[1] - 25), near=tuple(edge), stiffness=0.5, start=1200, stop=1500)
    seen = {}

    def watch(progress):
        if progress.iteration in (1199, 1500):
            seen[progress.iteration] = progress.tube()[..., :2].reshape(-1, 2)

    def nearest(iteration, place):
        return np.linalg.norm(seen[iteration] - place, axis=1).min()

    found = reconstruct(scene.views, [replace(scene.tubes[0], springs=(spring,))], scene.settings, callback=watch).objects[0]
    assert nearest(1199, spring.anchor) > 20 and nearest(1500, spring.anchor) < 1
    assert found.iterations > 1500
    before = np.concatenate([evenly(piece, 6000, False) for piece in rest.contour])
    gap = np.linalg.norm(np.concatenate(found.contour)[:, None] - before[None], axis=2).min(axis=1)
    assert gap.max() < 0.5


def test_a_run_that_is_pulled_while_it_goes_on_is_played_again_bit_by_bit():
    """Springs and a volcano, added one after the other on the way and at rest, against the same ones known beforehand."""
    scene = symseek.load(cli.demos()["squash"])
    tube = scene.tubes[0]
    with ThreadPoolExecutor(1) as pool:
        part = Relaxation(Assembly(scene.views, [tube], scene.settings, "cpu", maps_of(scene.views, [tube])), pool)
        wp.load_module(kernels, device="cpu")
        part.advance(37)
        first = part.pull(0, Spring((300.0, 240.0), point=(0.24, 0.5), stiffness=2.0))
        second = part.pull(0, Spring((165.0, 183.0, -45.0), point=(0.48, 0.25)))
        part.advance(41)
        part.let_go(first)
        part.advance(10_000)
        assert part.done and part.converged and part.last
        at_rest = part.iteration, part.scene.world(0)[0]
        part.let_go(second)
        third = part.pull(0, Spring((300.0, 360.0), reach=30.0, stiffness=0.01))
        part.advance(83)
        part.let_go(third)
        assert np.abs(part.scene.world(0)[0] - at_rest[1]).max() > 3
        part.advance(10_000)
        assert part.converged and part.iteration > at_rest[0] + 83
    springs, settings = tuple(part.scene.springs.list), part.scene.settings
    assert [s.start for s in springs] == [37, 37, at_rest[0]] and springs[0].stop == 78
    found = reconstruct(scene.views, [replace(tube, springs=springs)], settings)
    assert found.objects[0].converged and found.objects[0].iterations == part.iteration
    assert np.array_equal(found.objects[0].tube[0], part.scene.world(0)[0])


def test_a_spring_cannot_take_hold_in_the_past():
    rig, held = _springs(CAMERAS["orthographic"])
    held.set(7, rig.state.tube.numpy())
    with pytest.raises(ValueError, match="at iteration 6, which is over"):
        held.add(0, Spring((0.0, 0.0), point=(0.0, 0.0), start=6))


@pytest.mark.parametrize(
    "times, most",
    [([], 0), ([(0, None)], 1), ([(0, 5), (5, 9)], 1), ([(0, 6), (5, 9)], 2), ([(2, 9), (3, 4), (4, None), (4, 8)], 3)],
)
def test_how_many_springs_pull_at_once(times, most):
    assert most_at_once([Spring((0.0, 0.0), (0.0, 0.0), start=a, stop=b) for a, b in times]) == most


def test_a_body_without_an_image_takes_no_springs():
    tube = Tube(np.array([[0, 0, 0], [0, 1.0, 0]]), radius=0.1, springs=(Spring((0.0, 0.0, 0.0), point=(0.0, 0.5)),))
    with pytest.raises(ValueError, match="springs belong to a scene with an image"):
        Body([tube])
