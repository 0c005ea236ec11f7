"""Cameras against the formulas of (11), (15) and of the pinhole."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symseek.sim.camera import Camera
from symseek.sim.initial import lift

POINTS = np.random.default_rng(4).normal(size=(20, 3))
LENS = np.array([[700.0, 3, 320], [0, 720, 240], [0, 0, 1]])
TURN = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]).as_matrix()
SHIFT = np.array([0.2, -0.1, 6.0])
CAMERAS = {
    "orthographic": Camera.orthographic(0.5),
    "stereo": Camera.stereo(-0.3, 2.0),
    "perspective": Camera.perspective(LENS, TURN, SHIFT),
}
each_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def test_projections_by_their_formulas():
    x, y, z = POINTS.T
    np.testing.assert_allclose(CAMERAS["orthographic"].project(POINTS), np.stack([x, y], -1) / 0.5)
    np.testing.assert_allclose(CAMERAS["stereo"].project(POINTS), np.stack([x - 0.3 * z, y], -1) / 2)
    for point, seen in zip(POINTS, CAMERAS["perspective"].project(POINTS), strict=True):
        cx, cy, cz = TURN @ point + SHIFT
        np.testing.assert_allclose(seen, [700 * cx / cz + 3 * cy / cz + 320, 720 * cy / cz + 240])


@each_camera
def test_what_lies_on_a_line_of_sight_is_seen_as_one_point(camera):
    """i of (12): unit, and away from the viewer as distance says."""
    i = camera.sight(POINTS)
    np.testing.assert_allclose(np.linalg.norm(i, axis=-1), 1)
    np.testing.assert_allclose(camera.project(POINTS + 0.1 * i), camera.project(POINTS), atol=1e-9)
    np.testing.assert_allclose(camera.distance(POINTS + 0.1 * i) - camera.distance(POINTS), 0.1)


def test_sight_and_distance_start_at_the_viewer():
    assert CAMERAS["orthographic"].sight(POINTS).tolist() == [[0, 0, 1]] * 20
    centre = -TURN.T @ SHIFT
    np.testing.assert_allclose(CAMERAS["perspective"].distance(POINTS), np.linalg.norm(POINTS - centre, axis=1))
    ahead = TURN.T @ [0, 0, 1]
    assert np.all(CAMERAS["perspective"].sight(POINTS) @ ahead > 0.5)
    np.testing.assert_allclose(CAMERAS["stereo"].sight(POINTS[0]), np.array([0.3, 0, 1]) / np.sqrt(1.09))


def test_affine_cameras_are_told_from_perspective():
    assert [camera.affine for camera in CAMERAS.values()] == [True, True, False]


@each_camera
def test_lift_inverts_projection(camera):
    """Image points come back to themselves from any depth, and the depth is the one asked for."""
    seen = camera.project(POINTS)
    world = lift(seen, camera, 2.5)
    np.testing.assert_allclose(camera.project(world), seen, atol=1e-9)
    depth = camera.distance(world) if camera.affine else world @ TURN[2] + SHIFT[2]
    np.testing.assert_allclose(depth, 2.5)


def test_lift_refuses_a_perspective_view_without_depth():
    with pytest.raises(ValueError, match="positive depth"):
        lift(POINTS[:, :2], CAMERAS["perspective"], 0.0)
