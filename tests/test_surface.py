"""The smooth surface through a tube's nodes and its occluding contour, against closed forms."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from symseek.sim.camera import Camera
from symseek.sim.surface import occluding_contour, refine, smooth_grid, wire

TURN = Rotation.from_euler("xyz", [0.5, -0.7, 0.4]).as_matrix()
grids = pytest.mark.parametrize("grid", [(24, 25), (25, 25), (9, 13)])


def _ellipsoid(nx, ns, along=2.0, across=1.0):
    """Nodes at even parameter angles, poles at the ends, turned, off the origin: (nx, ns, 3)."""
    angle, turn = np.linspace(0, np.pi, ns), 2 * np.pi * np.arange(nx)[:, None] / nx
    radius = across * np.sin(angle)
    radius[[0, -1]] = 0
    axis = np.broadcast_to(-along * np.cos(angle), (nx, ns))
    return np.stack([radius * np.cos(turn), axis, -radius * np.sin(turn)], -1) @ TURN.T + [3.0, -2, 5]


def _ring_segment(nx, ns, angle=1.2, bend=4.0, radius=1.0):
    """An open piece of a torus, (nx, ns, 3)."""
    s, turn = np.linspace(0, angle, ns), 2 * np.pi * np.arange(nx)[:, None] / nx
    reach = bend + radius * np.cos(turn)
    height = np.broadcast_to(-radius * np.sin(turn), (nx, ns))
    return np.stack([reach * np.cos(s), reach * np.sin(s), height], -1)


def _mesh(tube):
    mesh = trimesh.Trimesh(*refine(tube), process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.euler_number == 2 and len(mesh.split()) == 1
    return mesh


def _prolate(a, c):
    """Area of an ellipsoid of half axes a, a, c > a."""
    e = np.sqrt(1 - (a / c) ** 2)
    return 2 * np.pi * a**2 * (1 + c / (a * e) * np.arcsin(e))


@grids
@pytest.mark.parametrize("along", [1.0, 2.0])
def test_volume_and_area_of_an_ellipsoid(grid, along):
    """4/3 pi a a c, positive: normals point outward. Its facets lie inside by about (pi / 96)^2."""
    mesh = _mesh(_ellipsoid(*grid, along=along))
    bound = 2e-3 if min(grid) > 20 else 5e-3
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * along, rel=bound)
    assert mesh.area == pytest.approx(4 * np.pi if along == 1 else _prolate(1.0, along), rel=bound)


@pytest.mark.parametrize("nx", [24, 25])
def test_open_tube_is_closed_by_flat_fans(nx):
    """A piece of a torus: pi r^2 R phi, 2 pi r R phi and two discs."""
    mesh = _mesh(_ring_segment(nx, 21))
    assert mesh.volume == pytest.approx(np.pi * 4.0 * 1.2, rel=2e-3)
    assert mesh.area == pytest.approx(2 * np.pi * 4.0 * 1.2 + 2 * np.pi, rel=2e-3)


@grids
def test_surface_runs_through_the_nodes(grid):
    nx, ns = grid
    for tube in (_ellipsoid(nx, ns), _ring_segment(nx, ns)):
        fine = smooth_grid(tube, around=2 * nx, along=3 * (ns - 1) + 1)
        np.testing.assert_allclose(fine[::2, ::3], tube, atol=1e-12)


def test_surface_is_smooth_through_the_poles():
    """No kink: distance of the finest rows round a pole to the exact ellipsoid falls with the grid, fourth order."""
    errors = []
    for n in (13, 25, 49):
        vertices, _ = refine(_ellipsoid(n, n))
        own = (vertices - [3.0, -2, 5]) @ TURN / [1, 2, 1]
        errors.append(np.abs(np.linalg.norm(own, axis=1) - 1).max())
    assert np.polyfit(np.log([13, 25, 49]), np.log(errors), 1)[0] < -3.5
    assert errors[1] < 1e-4


def test_poles_are_single_vertices_in_place():
    tube = _ellipsoid(25, 25)
    vertices, faces = refine(tube)
    for pole in tube[0, [0, -1]]:
        same = np.flatnonzero(np.linalg.norm(vertices - pole, axis=1) < 1e-9)
        assert len(same) == 1 and np.sum(faces == same[0]) == 96


def test_wire_lies_on_the_surface():
    tube = _ellipsoid(24, 25)
    lines = wire(tube, around=8, along=5)
    assert len(lines) == 13
    for line in lines:
        own = (line - [3.0, -2, 5]) @ TURN / [1, 2, 1]
        np.testing.assert_allclose(np.linalg.norm(own, axis=1), 1, atol=1e-4)
    assert all(np.allclose(ring[0], ring[-1]) for ring in lines[:5])


def _whole(pieces):
    """All points and normals of a contour."""
    return np.concatenate([p for p, _ in pieces]), np.concatenate([n for _, n in pieces])


@grids
def test_contour_of_a_sphere_is_its_circle(grid):
    pieces = occluding_contour(_ellipsoid(*grid, along=1.0), Camera.orthographic(0.5))
    points, normals = _whole(pieces)
    out = points - np.array([3.0, -2]) / 0.5
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 2.0, atol=2e-3)
    np.testing.assert_allclose(normals, out / 2.0, atol=5e-3)
    angles = np.sort(np.arctan2(*out.T))
    assert np.diff(angles, append=angles[0] + 2 * np.pi).max() < 0.2  # all the way round


def test_contour_of_a_sphere_in_perspective():
    """A circle of f r / sqrt(d^2 - r^2), larger than that of its greatest circle."""
    f, d = 500.0, 3.0
    camera = Camera.perspective(np.diag([f, f, 1]), np.eye(3), np.array([-3.0, 2, d - 5]))
    points, _ = _whole(occluding_contour(_ellipsoid(24, 25, along=1.0), camera))
    expected = f / np.sqrt(d**2 - 1)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), expected, rtol=1e-3)


def test_contour_by_15_is_an_ellipse():
    """xi = X + alpha Z of a unit sphere: half axes sqrt(1 + alpha^2) and 1."""
    points, _ = _whole(occluding_contour(_ellipsoid(24, 25, along=1.0), Camera.stereo(0.4)))
    own = (points - [3.0 + 0.4 * 5, -2]) / [np.sqrt(1.16), 1]
    np.testing.assert_allclose(np.linalg.norm(own, axis=1), 1, atol=2e-3)


def test_contour_of_an_open_tube_is_two_lines():
    """A straight tube across the view: lines a radius either side, from end to end."""
    nx, ns = 24, 11
    turn = 2 * np.pi * (np.arange(nx)[:, None] + 0.3) / nx
    height = np.broadcast_to(np.linspace(0, 5, ns), (nx, ns))
    tube = np.stack([np.cos(turn) + 0 * height, height, -np.sin(turn) + 0 * height], -1)
    pieces = occluding_contour(tube, Camera.orthographic())
    assert len(pieces) == 2
    for points, normals in pieces:
        side = np.sign(points[0, 0])
        np.testing.assert_allclose(points[:, 0], side, atol=1e-3)
        np.testing.assert_allclose(normals, np.tile([side, 0], (len(points), 1)), atol=2e-3)
        assert np.ptp(points[:, 1]) == pytest.approx(5)
