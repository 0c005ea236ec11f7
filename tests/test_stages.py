"""Pictures of several objects together: framing, wire frames, hidden contours, the turn."""

import gc
from pathlib import Path

import numpy as np
import pytest
import trimesh

from symseek.render.overlay import Drawing, Photo, draw
from symseek.render.raster import Renderer, Viewpoint
from symseek.render.stages import Stage, framed, stages_sheet, turning_frames
from symseek.render.video import write_mp4

RED, BLUE = (220, 60, 40), (60, 90, 220)


def ball(centre, radius, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


@pytest.mark.parametrize("size", [(320, 200), (150, 240)])
def test_one_framing_holds_the_whole_turn(size):
    points = np.random.default_rng(3).uniform([-7, 2, 30], [9, 6, 36], (400, 3))
    front = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    places, frames = [], [framed(points, size, azimuth, 9.0, front) for azimuth in range(0, 360, 5)]
    for view in frames:
        places.append(view.project(points, *size))
        assert (np.abs(view.look(points)[:, 2]) < 3).all()  # between the camera's planes
    share = np.abs((np.array(places) - (np.array(size) - 1) / 2) / (np.array(size) / 2)).max(axis=(0, 1))
    assert (share <= 1).all() and share.max() > 0.75  # all of it, and no smaller than need be
    assert len({view.radius for view in frames}) == 1


def test_wires_have_their_objects_colours_and_hide_each_other():
    angle = np.linspace(0, 2 * np.pi, 120)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(120)])
    near, far = (*ball((0, 0, -0.5), 0.3), RED), (*ball((0.2, 0, 0.5), 0.3), BLUE)
    lines = [[0.3 * ring + [0, 0, -0.5]], [0.3 * ring + [0.2, 0, 0.5]]]
    with Renderer(200, 200) as renderer:
        picture = renderer.wires([near, far], Viewpoint(np.zeros(3), 1.0, margin=1.0), lines, (255, 255, 255)).astype(int)
    red, blue = picture[..., 0] - picture[..., 2] > 60, picture[..., 2] - picture[..., 0] > 60
    row, column = np.nonzero(blue)
    inside = np.hypot(column - 99.5, row - 99.5) < 28  # behind the near ball, whose radius is 30 px
    assert len(row) > 60 and not inside.any() and red[:, 68:72].any() and red[:, 128:132].any()
    assert (picture[[0, -1]] == 255).all()


def test_hidden_contour_is_dashed_in_its_colour():
    line = np.column_stack([np.linspace(5, 95, 91), np.full(91, 50.0)])
    hidden = line[:, 0] > 50
    photo = Photo(np.ones((100, 100)), (400, 400))

    def inked(drawing):
        picture = photo.picture.copy()
        draw(picture, photo, drawing, 1.0)
        return picture[int(photo.place(line)[0, 1]), :, 0] < 235

    whole = inked(Drawing(contour=(line,), colour=BLUE))
    half = inked(Drawing(contour=(line,), hidden=(hidden,), colour=BLUE))
    np.testing.assert_array_equal(whole[30:190], half[30:190])
    assert whole[210:375].all() and 0.4 < half[210:375].mean() < 0.95
    assert np.abs(np.diff(half[210:375].astype(int))).sum() >= 8
    loose = inked(Drawing(contour=(line,), support=(~hidden,), hidden=(hidden,), colour=BLUE))
    np.testing.assert_array_equal(loose[30:375], half[30:375])  # nobody asks the image for what it cannot show


def test_sheet_shows_start_and_end_in_six_panels():
    image = np.ones((60, 90))
    axis = np.array([[15.0, 30.0], [75.0, 30.0]])
    lower, small, large = axis + np.array([0, 8]), ball((45, 30, 0), 6), ball((45, 30, 0), 24)
    stages = [Stage(RED, axis, lower, small, large, [np.column_stack([axis, [-9.0, -9.0]])])]
    sheet = stages_sheet(image, stages, width=600).astype(int)
    assert sheet.shape == (3 * 402 + 2, 2 * 602 + 2, 3)
    tiles = [sheet[2 + 402 * (k // 2) :, 2 + 602 * (k % 2) :][:400, :600] for k in range(6)]
    reds = [(tile[..., 0] - tile[..., 2] > 60) for tile in tiles]
    rows = [round((y + 0.5) * 600 / 90) for y in (30, 38)]  # where the axes lie
    for tile, row in zip((reds[0], reds[2]), rows, strict=True):
        assert tile[row - 3 : row + 3].sum() > 300 and not tile[: row - 6].any() and not tile[row + 6 :].any()
    assert reds[4].sum() == pytest.approx(reds[1].sum() * 16, rel=0.15) and reds[3].any()
    e = np.radians(9.0)  # room for a cylinder seen from above
    assert reds[5].sum() == pytest.approx(reds[4].sum() / (np.cos(e) + np.sin(e)) ** 2, rel=0.05)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_a_turn_holds_no_memory(tmp_path):
    """Three hundred frames after the first hundred, coded and written, take no tenth more."""
    meshes = [(*ball((x, 0, 0), 0.5), RED) for x in range(6)]
    held = []

    def watched():
        for k, frame in enumerate(turning_frames(meshes, frames=400, size=(64, 40))):
            if k in (100, 399):
                gc.collect()
                held.append(int(Path("/proc/self/statm").read_text().split()[1]))
            yield frame

    assert write_mp4(tmp_path / "turn.mp4", watched()) == 400
    assert held[1] < 1.1 * held[0]


def test_a_turn_ends_where_it_began():
    meshes = [(*ball((-2, 0, 0), 0.5), RED), (*ball((2, 0, 0), 0.5), BLUE)]
    frames = list(turning_frames(meshes, frames=4, size=(80, 50)))
    red = [(frame[..., 0].astype(int) - frame[..., 2] > 40).nonzero()[1].mean() for frame in (frames[0], frames[2])]
    assert len(frames) == 4 and red[0] < 30 and red[1] > 50
