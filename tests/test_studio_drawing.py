"""What the studio draws lies where it belongs: in the photograph by the scene's camera, in space by a similarity."""

from dataclasses import replace

import numpy as np
import pytest
import viser
from viser.transforms import SO3

from symseek import cli
from symseek.sim.camera import Camera
from symseek.sim.curve import evenly
from symseek.sim.problem import View
from symseek.sim.surface import occluding_contour
from symseek.studio.drawing import Drawing, Frame, away_from, material_point
from symseek.studio.handle import away, handle, rate
from symseek.studio.keep import Folder
from symseek.studio.lines import COARSE, FINE, lines_of
from symseek.studio.marks import CREASE, GAP, NOT_HERE, marks_of
from symseek.studio.part import Snapshot
from symseek.studio.ribbons import OVERLAP, Ribbons, strips_of

T = np.linspace(0, 1, 25)
SPINE = np.stack([30 + 60 * T, 40 + 12 * np.sin(3 * T), 5 * T], axis=1)
RADIUS = 12 * np.sqrt(np.clip(1 - (2 * T - 1) ** 4, 0, None))
ANGLE = 2 * np.pi * np.arange(25) / 25
TUBE = SPINE + RADIUS[:, None] * np.stack(
    [0 * ANGLE, np.cos(ANGLE), np.sin(ANGLE)], axis=1
)[:, None]  # fmt: skip
K = np.array([[400.0, 0, 60], [0, 400, 45], [0, 0, 1]])
CAMERAS = {
    "orthographic": Camera.orthographic(0.5),
    "stereo": Camera.stereo(0.3),
    "perspective": Camera.perspective(K, np.eye(3), np.array([-60.0, -45, 400])),
}


def snapshot(cuts=()) -> Snapshot:
    return Snapshot(TUBE, SPINE, list(cuts), 0, 0, 1, 1.0, 1.0, False, False, False, [])


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("many", [False, True])
def test_the_contour_that_is_drawn_is_the_occluding_one(name, many):
    """Against the measured contour of the smooth surface; through 25 nodes less closely, at blunt ends least."""
    view = View(np.zeros((90, 120)), CAMERAS[name])
    (wire, _), (contour, _), _ = lines_of([snapshot()], view, COARSE if many else FINE)
    truth = np.concatenate([evenly(p, 200, False) for p, _ in occluding_contour(TUBE, view.camera)])
    drawn = np.concatenate([(1 - t) * contour[:, 0] + t * contour[:, 1] for t in np.linspace(0, 1, 5)])
    radius = 12 * max(np.linalg.norm(view.camera.matrix[0, :3]), 1.0) if view.camera.affine else 12
    assert max(np.linalg.norm(p - drawn, axis=1).min() for p in truth) < (0.3 if many else 0.05) * radius, "all of it"
    assert max(np.linalg.norm(p - truth, axis=1).min() for p in drawn) < (0.15 if many else 0.05) * radius
    assert len(wire) > (20 if many else 60)


def test_models_drawn_together_are_drawn_as_each_alone():
    """Alike or not, open or parted, in the order that they are given in."""
    rng = np.random.default_rng(2)
    several = [replace(snapshot(cuts), tube=TUBE + rng.normal(size=3), spine=SPINE + rng.normal(size=3))
               for cuts in ([], [(11, True)], [], [(5, False)])]  # fmt: skip
    several[2] = replace(several[2], tube=several[2].tube[:, 2:-2], spine=several[2].spine[2:-2])
    view = View(np.zeros((90, 120)), CAMERAS["perspective"])
    singly = [lines_of([s], view, FINE) for s in several]
    for (segments, which), *alone in zip(lines_of(several, view, FINE), *singly, strict=True):
        assert np.array_equal(which, np.repeat(range(4), [len(lot) for lot, _ in alone])) and len(np.unique(which)) == 4
        np.testing.assert_allclose(segments, np.concatenate([lot for lot, _ in alone]), atol=1e-9)


def test_a_gap_is_not_drawn_across():
    view = View(np.zeros((90, 120)))
    (wire, _), (contour, _), _ = lines_of([snapshot([(11, True)])], view, FINE)
    middle = SPINE[11:13].mean(axis=0)[0]
    for lines in (wire, contour):
        crossing = (lines[..., 0].min(axis=1) < middle) & (lines[..., 0].max(axis=1) > middle)
        assert len(lines) and not crossing.any()


@pytest.mark.parametrize("name", CAMERAS)
def test_models_in_space_keep_their_shape_and_lie_over_the_photograph(name):
    """A similarity that to first order is the camera's own view; and back."""
    view = View(np.zeros((90, 120)), CAMERAS[name])
    depth = 400.0 if name == "perspective" else 0.0
    frame = Frame(view, depth)
    shown = frame.shown(TUBE)
    np.testing.assert_allclose(frame.world(shown), TUBE, atol=1e-9)
    a, b = (np.linalg.norm(np.diff(v.reshape(-1, 3), axis=0), axis=1) for v in (TUBE, shown))
    np.testing.assert_allclose(b, frame.scale * a, rtol=1e-9)
    near = frame.origin + 0.01 * np.random.default_rng(0).normal(size=(20, 3))
    gap = frame.shown(near)[:, :2] - view.camera.project(near)
    slant = 0.3 * np.abs((near - frame.origin)[:, 2]).max() if name == "stereo" else 0.0  # the paper's (15) is oblique
    assert np.abs(gap).max() < slant * frame.scale + 1e-3


def test_the_handle_stands_beside_the_middle_of_the_axis():
    axis = np.array([[0.0, 0], [30, 0], [30, 10]])
    foot, knob = handle(axis, 5.0)
    np.testing.assert_allclose([foot, knob], [[20, 0], [20, -5]])
    assert abs(away(axis, knob) - 5) < 1e-12 and abs(away(axis, np.array([33.0, 14.0])) - 5) < 1e-12
    np.testing.assert_allclose(rate(CAMERAS["orthographic"], TUBE[0, 12]), [[2, 0, 0], [0, 2, 0]], atol=1e-6)
    near = rate(
        CAMERAS["perspective"], np.array([0.0, 45, -200])
    )  # f / Z = 400 / 200, and the axis leads through the middle
    np.testing.assert_allclose(near, [[2, 0, 0.6], [0, 2, 0]], atol=1e-3)


def test_a_place_is_found_on_the_near_side():
    view = View(np.zeros((90, 120)))
    front = TUBE[:, 12, 2].argmin()
    x, s = material_point(snapshot(), away_from(snapshot(), view, TUBE[front, 12, :2]))
    assert (round(x * 25), round(s * 24)) == (front, 12)


def test_photographs_stand_where_their_cameras_look():
    """Beside the one in hand another's is moved, turned and scaled as a whole: what it sees lies on it by its own camera."""
    turn = np.array([[np.cos(0.6), 0, -np.sin(0.6)], [0, 1, 0], [np.sin(0.6), 0, np.cos(0.6)]])
    middle = TUBE.reshape(-1, 3).mean(axis=0)
    cameras = [Camera.perspective(K, r, np.array([0, 0, 400.0]) - r @ middle) for r in (np.eye(3), turn)]
    views = [View(np.zeros((90, 120, 3), np.float32), camera) for camera in cameras]
    frames = [Frame(view, 400.0) for view in views]
    server = viser.ViserServer(port=0, verbose=False)
    try:
        drawing = Drawing(server.scene, views, frames)
        assert drawing.pictures[0].visible and not drawing.pictures[1].visible
        drawing.look(0, True)
        picture = drawing.pictures[1]
        assert picture.visible
        place = SO3(np.array(picture.wxyz)).as_matrix() * picture.scale
        for corner in ([0, 0], [119, 0], [60, 89]):
            at = np.array(picture.position) + place @ (np.array([*corner, 0.0]) - [59.5, 44.5, 0])
            np.testing.assert_allclose(at, frames[0].shown(frames[1].world(np.array([*corner, 0.0]))), atol=1e-6)
        drawing.look(1, False)
        assert picture.visible and not drawing.pictures[0].visible and drawing.view is views[1]
        np.testing.assert_allclose(picture.wxyz, [1, 0, 0, 0])
    finally:
        server.stop()


def test_lines_are_strips_of_their_colours():
    """As thick as is asked for whatever the eye's distance; a mesh that keeps its room is sent anew without its faces."""
    segments = np.array([[[10.0, 10], [40, 10]], [[40, 10], [40, 50]], [[np.nan, 0], [1, 1]], [[0, 0], [6, 8]]])
    colours = np.array([[255, 0, 0], [255, 0, 0], [255, 0, 0], [0, 10, 255]])
    sides = np.linalg.norm(np.diff(strips_of(segments[[0, 1, 3]], 2.0), axis=1), axis=2)
    np.testing.assert_allclose(sides[:, [0, 2]], 2.0)
    np.testing.assert_allclose(sides[:, 1], np.array([30, 40, 10]) + 2 * 2.0 * OVERLAP)
    server = viser.ViserServer(port=0, verbose=False)
    try:
        ribbons = Ribbons(server.scene, "test", 3.0)
        ribbons.show(segments, colours, -1.0, 0.5)
        red, blue = (ribbons._meshes[colour] for colour in (0xFF0000, 0x000AFF))
        assert red.color == (255, 0, 0) and blue.color == (0, 10, 255) and red.visible and blue.visible
        corners = red.vertices[red.faces].reshape(-1, 2, 3, 3)
        way = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        areas = 0.5 * np.linalg.norm(way, axis=2).sum(axis=1)
        np.testing.assert_allclose(areas[:2], (np.array([30, 40]) + 3 * OVERLAP) * 1.5, rtol=1e-5)
        assert (areas[2:] == 0).all() and (red.vertices[:, 2] == -1).all()
        ribbons.show(segments[:1] + 5, colours[:1], -1.0, 0.5)
        assert ribbons._meshes[0xFF0000] is red and not blue.visible and red.vertices[:, 0].min() > 14
        ribbons.show(np.repeat(segments[:1], 100, axis=0), colours[:1].repeat(100, axis=0), -1.0, 0.5)
        assert len(ribbons._meshes[0xFF0000].vertices) == 4 * 128
    finally:
        server.stop()


def test_what_was_marked_is_shown_where_it_is():
    """Marks, creases and gaps of the first view; nodes that were painted where the model has them."""
    session = Folder(cli.demos()["squash"].parent).open("scene.toml")[0]
    session.mark(1, (60, 70))
    session.break_at(1, (260, 278))
    session.break_at(1, (300, 290), "position")
    session.paint(1, [(3, 10), (4, 11)])
    (item,) = session.state.items
    found = {colour: points.tolist() for points, colour in marks_of(session, item, None, 0)}
    assert found == {NOT_HERE: [[60, 70]], CREASE: [[260, 278]], GAP: [[300, 290]]}
    points, colour = marks_of(session, item, snapshot(), 0)[-1]
    assert colour == CREASE and points.tolist() == session.view.camera.project(TUBE[[3, 4], [10, 11]]).tolist()
