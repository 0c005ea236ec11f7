"""Normals, the occluding contour and the image force on it, against closed forms, differences and conservation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skimage import measure

from symseek.kernels import contour
from symseek.sim.camera import Camera
from tests import reference, rig
from tests.rig import Rig, circles, even_spine

ATOL = 3e-6
"""A few roundings of float32 on numbers of order one."""
LENS = np.array([[700.0, 0, 320], [0, 720, 240], [0, 0, 1]])
TURN = Rotation.from_euler("xyz", [0.5, -0.7, 0.4]).as_matrix()
CAMERAS = {
    "orthographic": Camera.orthographic(0.5),
    "stereo": Camera.stereo(0.4, 0.8),
    "perspective": Camera.perspective(LENS, Rotation.from_euler("y", 0.2).as_matrix(), np.array([0.1, -0.2, 3.0])),
}
each_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def _ellipsoid(nx, ns, along=0.5, across=0.5, turn=TURN):
    """Nodes at even parameter angles, poles at the ends, turned; middle at 0. Tube and spine."""
    angle = np.linspace(0, np.pi, ns)
    spine = -along * np.cos(angle)[:, None] * np.array([0.0, 1, 0])
    radius = across * np.sin(angle)
    radius[[0, -1]] = 0
    return circles(spine, radius, nx, 0.2) @ turn.T, spine @ turn.T


def _cone(nx, ns, r0, r1, turn=TURN):
    """An open cone of length 1 along Y (a cylinder where r0 = r1), turned."""
    spine = even_spine(ns)
    return circles(spine, np.linspace(r0, r1, ns), nx, 0.2) @ turn.T, spine @ turn.T


def _flat(value):
    """A picture with the same sample everywhere."""
    return np.tile(np.asarray(value, float), (2, 2, 1)), (0.0, 0.0), 1.0


def _linear(value, half=4.0):
    """A picture of samples that are linear in the image point, value(column, row) -> four numbers."""
    corners = [[value(x, y) for x in (-half, half)] for y in (-half, half)]
    # a third row and column keep bilinear look-ups off the border, where they stop a thousandth short
    samples = np.array(corners, float)
    wide = np.concatenate([samples, 2 * samples[:, 1:] - samples[:, :1]], axis=1)
    return np.concatenate([wide, 2 * wide[1:] - wide[:1]]), (-half, -half), 2 * half


@each_camera
def test_normals_of_an_ellipsoid_and_i_n(camera):
    """n is the gradient of x' M x; even parameter angles make central differences exact. Poles: the axis."""
    tube, spine = _ellipsoid(10, 11, 0.5, 0.3)
    r = Rig((tube, spine), closed=True, camera=camera)
    r.forces()
    normal = (tube @ TURN) / np.array([0.3, 0.5, 0.3]) ** 2
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = normal @ TURN.T
    np.testing.assert_allclose(r.state.normal.numpy().reshape(tube.shape), normal, atol=3 * ATOL)
    if camera.affine:
        sight = np.cross(camera.matrix[0, :3], camera.matrix[1, :3])
    else:
        sight = tube + np.linalg.inv(camera.matrix[:, :3]) @ camera.matrix[:, 3]
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    facing = np.sum(sight * normal, axis=-1)
    np.testing.assert_allclose(r.state.facing.numpy().reshape(facing.shape), facing, atol=3 * ATOL)


def test_normals_of_a_cone_reach_its_rims():
    tube, spine = _cone(9, 6, 0.2, 0.5)
    r = Rig((tube, spine))
    r.forces()
    out = circles(0 * even_spine(6), 1.0, 9, 0.2)
    normal = (out - 0.3 * np.array([0, 1, 0])) / np.sqrt(1.09) @ TURN.T
    np.testing.assert_allclose(r.state.normal.numpy().reshape(tube.shape), normal, atol=3 * ATOL)


def test_normals_converge():
    """A wavy profile r(s): second order off the rims."""
    sizes, errors = (17, 33, 65, 129), []
    for ns in sizes:
        s = np.linspace(0, 1, ns)
        tube = circles(even_spine(ns), 0.3 + 0.1 * np.sin(2 * np.pi * s), 8)
        slope = 0.2 * np.pi * np.cos(2 * np.pi * s)[:, None]
        normal = circles(0 * even_spine(ns), 1.0, 8) - slope[..., None] * [0, 1, 0]
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        r = Rig((tube, even_spine(ns)))
        r.forces()
        errors.append(np.abs(r.state.normal.numpy().reshape(tube.shape) - normal)[1:-1].max())
    assert reference.slope(sizes, errors) >= 1.8


def _crossings(r):
    """Points where the contour crosses edges of rings and of meridians, from the kernels' functions."""
    nx, ns = r.model.grids[0]
    sign = r.state.facing.numpy().reshape(ns, nx) >= 0
    out = rig.array(np.full((ns * nx, 3), np.nan), rig.wp.vec3)
    r.launch(rig.ring_crossings, ns * nx, n=nx, position_out=out)
    ring = out.numpy().reshape(ns, nx, 3)[sign != np.roll(sign, -1, axis=1)]
    r.launch(rig.meridian_crossings, (ns - 1) * nx, n=nx, ns=ns, position_out=out)
    meridian = out.numpy().reshape(ns, nx, 3)[:-1][sign[1:] != sign[:-1]]
    return ring.astype(float), meridian.astype(float)


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_crossings_lie_on_the_contour_to_third_order(shape):
    """Distance in the image to the circle of a sphere, to the lines of a tilted cylinder."""
    sizes, errors = (8, 11, 16, 22, 32), []
    for n in sizes:
        r = Rig(_ellipsoid(n, n + 1) if shape == "sphere" else _cone(n, 6, 0.3, 0.3), closed=shape == "sphere")
        r.forces()
        ring, meridian = _crossings(r)
        if shape == "sphere":
            assert len(ring) > 0 and len(meridian) > 0
            errors.append(np.abs(np.linalg.norm(np.concatenate([ring, meridian])[:, :2], axis=1) - 0.5).max())
        else:
            assert len(ring) == 12 and len(meridian) == 0
            axis = TURN[:2, 1] / np.linalg.norm(TURN[:2, 1])
            errors.append(np.abs(np.abs(ring[:, :2] @ [axis[1], -axis[0]]) - 0.3).max())
    assert reference.slope(sizes, errors) >= 3
    assert errors[-1] < 2e-5


def test_a_linear_potential_pulls_by_the_contours_length():
    """(11) with gradient g: the force is g times the length 2 of the cylinder's contour, at the contour's middle."""
    g = np.array([0.3, -0.7])
    for turn in (np.eye(3), TURN):
        tube, spine = _cone(12, 7, 0.3, 0.3, turn)
        r = Rig((tube, spine), picture=_flat([*g, 0, 0]))
        force = r.forces(literal=True)[0] / (12 * 6)
        length = 2 * np.linalg.norm(spine[-1, :2] - spine[0, :2])
        np.testing.assert_allclose(force.sum((0, 1)), [*(length * g), 0], atol=ATOL)
        torque = np.cross(tube, force).sum((0, 1))
        np.testing.assert_allclose(torque, np.cross(spine.mean(0), [*(length * g), 0]), atol=2e-4)


def test_a_spring_field_pulls_each_side_to_its_edge():
    """Normalised pull x_edge - x across the lines x = +-0.3 of a cylinder: 0.2 outward on each, for 1 of length."""
    tube, spine = _cone(24, 7, 0.3, 0.3, np.eye(3))
    outward = _linear(lambda x, y: (x * 2 / 3, 0, 0, 0))  # 0.2 at 0.3
    force = Rig((tube, spine), picture=outward).forces()[0] / (24 * 6)
    right = tube[..., 0] > 0
    for side, expected in ((right, 0.2), (~right, -0.2)):
        np.testing.assert_allclose(force[side].sum(0), [expected, 0, 0], atol=1e-4)
    along = _linear(lambda x, y: (0, 1, 0, 0))  # along the contour: no pull
    np.testing.assert_allclose(Rig((tube, spine), picture=along).forces()[0], 0, atol=1e-4)


def test_pressure_pushes_outward_and_does_the_work_of_an_area():
    """Closed contour: no net force, and sum v.f = twice the area within, 2 pi r^2 on a sphere, second order."""
    sizes, errors = (8, 16, 32), []
    for n in sizes:
        tube, spine = _ellipsoid(n, n + 1)
        force = Rig((tube, spine), closed=True, picture=_flat([0, 0, 1, 0])).forces()[0] / n**2
        np.testing.assert_allclose(force.sum((0, 1)), 0, atol=ATOL)
        errors.append(abs(np.sum(tube * force) - 2 * np.pi * 0.25))
    assert reference.slope(sizes, errors) >= 1.8
    assert errors[-1] < 0.01


def test_a_sphere_in_perspective():
    """Constant (11)-gradient (1, 0) on the circle of a sphere: 2 pi f rho / z pixels, each (1 + (rho / z)^2)^(-1/4)."""
    distance, radius, n = 2.0, 0.5, 48
    tube, spine = _ellipsoid(n, n + 1)
    camera = Camera.perspective(np.diag([600.0, 600, 1]), np.eye(3), np.array([0, 0, distance]))
    force = Rig((tube, spine), closed=True, camera=camera, picture=_flat([1, 0, 0, 0])).forces(literal=True)[0] / n**2
    rho, z = radius * np.sqrt(1 - (radius / distance) ** 2), distance - radius**2 / distance
    expected = 2 * np.pi * (600 * rho / z) * (1 + (rho / z) ** 2) ** -0.25
    np.testing.assert_allclose(force.sum((0, 1)), [expected, 0, 0], rtol=4e-3, atol=4e-3 * expected)


@pytest.mark.parametrize("strong", [1, -1])
def test_every_case_of_a_cell_is_drawn(strong):
    """Random i.n on a flat sheet: the length of all pieces is that of scikit-image's contours.

    Saddles join the corners of the sign that is stronger.
    """
    nx, ns, rng = 14, 13, np.random.default_rng(3)
    sign = rng.choice([-1.0, 1.0], (ns, nx))
    sign[:, [0, 1, -2, -1]] = -1.0  # none across the seam
    facing = sign * np.where(sign == strong, rng.uniform(0.6, 1, sign.shape), rng.uniform(0.2, 0.6, sign.shape))
    y, x = np.mgrid[:ns, :nx].astype(float)
    sheet = np.stack([x, y, 0 * x], -1)
    r = Rig((sheet, sheet[:, 0]), picture=_flat([1, 0, 0, 0]))
    r.state.normal.assign(np.tile(np.array([0, 0, -1], np.float32), (ns * nx, 1)))
    r.state.facing.assign(facing.ravel().astype(np.float32))
    r.state.force.zero_()
    r.launch(contour.contour_force, ns, view=0, literal=1, fields=r.model.fields[:, 0])
    lines = measure.find_contours(facing, 0.0, fully_connected="high" if strong > 0 else "low")
    length = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines)
    total = r.state.force.numpy().astype(float).sum(0) / (nx * (ns - 1))
    np.testing.assert_allclose(total, [length, 0, 0], rtol=1e-5, atol=1e-3)


def test_crossings_of_parabolas_are_exact_up_to_the_rims():
    """Nodes quadratic in s: the interpolation keeps them, also in the first and last cell of an open tube."""
    nx, ns, rng = 9, 7, np.random.default_rng(6)
    a, b, c = rng.normal(size=(3, nx, 3))
    s = np.arange(ns)[:, None, None]
    facing = np.where(np.arange(ns)[:, None] % 2, 1, -1) * rng.uniform(0.2, 1, (ns, nx))
    r = Rig((a + 0.3 * b * s + 0.1 * c * s**2, np.zeros((ns, 3))))
    r.state.facing.assign(facing.ravel().astype(np.float32))
    out = rig.array(np.full((ns * nx, 3), np.nan), rig.wp.vec3)
    r.launch(rig.meridian_crossings, (ns - 1) * nx, n=nx, ns=ns, position_out=out)
    at = s[:-1] + (facing[:-1] / (facing[:-1] - facing[1:]))[..., None]
    exact = a + 0.3 * b * at + 0.1 * c * at**2
    np.testing.assert_allclose(out.numpy().reshape(ns, nx, 3)[:-1], exact, atol=3 * ATOL)


def _quadratic(p):
    """A smooth potential whose gradient is linear, (value, gradient)."""
    m, g = np.array([[2.0, 0.5], [0.5, -1.0]]) * 1e-3, np.array([0.3, -0.2])
    return 0.5 * p @ m @ p + g @ p, m @ p + g


def _on_all_nodes(camera, picture, literal):
    """Force of the switch (12) that is on everywhere, and the nodes."""
    r = Rig(_ellipsoid(6, 7), closed=True, camera=camera, picture=picture)
    force, _ = r.forces("switch", literal, tau=1.1)
    return force.reshape(-1, 3), r


def test_force_is_the_gradient_of_the_projected_potential():
    """d P(Pi(v)) / dv by differences; one gain for every camera."""
    gains = []
    for camera in CAMERAS.values():
        picture = _linear(lambda x, y: (*_quadratic(np.array([x, y]))[1], 0, 0), half=1000.0)
        force, r = _on_all_nodes(camera, picture, literal=True)
        nodes = r.tube().reshape(-1, 3)

        def energy(v, matrix=camera.matrix):
            return float(_quadratic(reference.project(matrix, v))[0])

        exact = np.stack([reference.gradient(energy, v, 1e-5) for v in nodes])
        gains.append(np.sum(force * exact) / np.sum(exact**2))
        np.testing.assert_allclose(force, gains[-1] * exact, atol=1e-4 * np.abs(force).max())
    np.testing.assert_allclose(gains, gains[0], rtol=1e-4)


@each_camera
def test_normalised_force_is_the_least_displacement(camera):
    """Pressure 1: the force is pinv(J) times the image normal J n / |J n|, for the switch's one gain."""
    force, r = _on_all_nodes(camera, _flat([0, 0, 1, 0]), literal=False)
    normal = r.state.normal.numpy().astype(float)
    expected = np.zeros_like(force)
    for k, v in enumerate(r.tube().reshape(-1, 3)):
        columns = [reference.gradient(lambda p, j=j: reference.project(camera.matrix, p)[j], v, 1e-5) for j in (0, 1)]
        jacobian = np.stack(columns)
        m = jacobian @ normal[k]
        expected[k] = np.linalg.pinv(jacobian) @ m / np.linalg.norm(m)
    visible = np.abs(r.state.facing.numpy()) < 0.99  # no direction in the image straight at the viewer
    gain = np.sum(force[visible] * expected[visible]) / np.sum(expected[visible] ** 2)
    assert gain > 0
    np.testing.assert_allclose(force[visible], gain * expected[visible], atol=2e-4 * np.abs(force).max())


@pytest.mark.parametrize("tau", [0.05, 0.3])
def test_switch_12_activates_nodes_below_tau(tau):
    tube, spine = _ellipsoid(24, 25)
    force, _ = Rig((tube, spine), closed=True, picture=_flat([1, 1, 0, 0])).forces("switch", True, tau)
    facing = tube[..., 2] / 0.5  # i.n on a sphere seen along Z
    assert np.abs(np.abs(facing) - tau).min() > 1e-5
    active = np.abs(force).max(axis=-1) > 0
    np.testing.assert_array_equal(active, np.abs(facing) < tau)
    assert 0 < active.sum() < active.size


def test_poles_on_the_contour_are_pushed_along_the_spine():
    """Closed ends in the image plane: sample.w outward along the spine; ends that face the viewer: nothing."""
    across = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    for turn, push in ((across, 0.7), (Rotation.from_euler("x", 90, degrees=True).as_matrix(), 0.0)):
        tube, spine = _ellipsoid(8, 9, turn=turn)
        force, _ = Rig((tube, spine), closed=True, picture=_flat([0, 0, 0, 0.7])).forces()
        outward = tube[-1, 0] / 0.5
        np.testing.assert_allclose(force[-1], np.tile(push * outward, (8, 1)), atol=ATOL)
        np.testing.assert_allclose(force[0], np.tile(-push * outward, (8, 1)), atol=ATOL)
        np.testing.assert_array_equal(force[1:-1], 0)


def test_pole_of_a_flat_end_keeps_its_normal():
    """It is that of the ring beside it, wherever in the ring's plane rounding puts the pole."""
    spine = even_spine(7)
    tube = circles(spine, 0.3, 12)
    for end, beside in ((0, 1), (-1, -2)):
        tube[end] = spine[beside] + np.array([0.0, 1e-7, 1e-6])
    rig = Rig((tube, spine), closed=True)
    rig.forces()
    normal = rig.state.normal.numpy().reshape(7, 12, 3)
    for end, side in ((0, -1.0), (-1, 1.0)):
        np.testing.assert_allclose(normal[end], np.tile([0, side, 0], (12, 1)), atol=1e-5)
