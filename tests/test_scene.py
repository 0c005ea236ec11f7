"""Scene files that are good: what they read as, overrides, and the script that says the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image

import symseek
from symseek import cli, files
from symseek.scene import build
from symseek.sim.camera import Camera

SCENE = """
name = "pair"
units = "mm"
scale = 0.5
[[view]]
image = "photo.png"
ignore = "ignore.png"
[[object]]
name = "left"
spine = [[20, 30], [40, 32], [60, 30]]
radius = 4.0
depth = -2.0
grid = [12, 20]
not_here = [[3, 4]]
[[object.break]]
at = 0.3
order = "tangent"
of = "spine"
[[object.break]]
at = [40, 30]
time = 12
[object.material]
w20 = 2e-4
w2 = [1e-6, 2e-6]
k01 = { times = [0, 10], values = [0.0, [0.1, 0.2]] }
L01 = 1.1
[[object]]
name = "right"
spine = [[10, 15, 1], [30, 15, 2]]
[solver]
scheme = "euler"
sigmas = [8, 4.0]
[output]
video = false
"""


@pytest.fixture
def folder(tmp_path):
    rows, columns = np.mgrid[:64, :80]
    Image.fromarray((rows + columns).astype(np.uint8)).save(tmp_path / "photo.png")
    mask = np.zeros((64, 80), np.uint8)
    mask[:5] = 255
    Image.fromarray(mask).save(tmp_path / "ignore.png")
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


def test_every_key_arrives(folder):
    scene = symseek.load(folder / "scene.toml")
    assert (scene.name, scene.units, scene.scale) == ("pair", "mm", 0.5)
    (view,) = scene.views
    assert view.image.shape == (64, 80) and view.image.dtype == np.float32 and view.image[3, 4] == np.float32(7 / 255)
    assert view.ignore is not None and view.ignore.sum() == 5 * 80
    np.testing.assert_allclose(view.camera.project(np.array([10.0, 20.0, 7.0])), [20, 40])
    left, right = scene.tubes
    assert (left.name, left.radius, left.depth, left.grid) == ("left", 4.0, -2.0, (12, 20))
    growing = {"times": [0, 10], "values": [0.0, [0.1, 0.2]]}
    assert left.material == symseek.Material(w20=2e-4, w2=[1e-6, 2e-6], k01=growing, L01=1.1)
    assert right.material == symseek.Material() and right.breaks == ()
    assert left.breaks == (symseek.Break(0.3, "tangent", "spine"), symseek.Break((40.0, 30.0), time=12.0))
    np.testing.assert_array_equal(left.not_here, [[3, 4]])
    assert left.spine.shape == (3, 2) and right.spine.shape == (2, 3) and right.radius is None
    assert scene.settings == symseek.Settings(scheme="euler", sigmas=(8.0, 4.0))
    assert not scene.output.video and scene.output.overlay


def test_a_folder_stands_for_its_scene_file(folder):
    assert symseek.load(folder).name == "pair"


def test_environment_variables_in_image_paths(folder, monkeypatch):
    monkeypatch.setenv("SOMEWHERE", str(folder))
    scene = symseek.load(folder, ["view.image=$SOMEWHERE/photo.png"])
    assert scene.views[0].image.shape == (64, 80)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["object.grid=[16, 18]"], [(16, 18), (16, 18)]),
        (["object.0.grid=[16, 18]"], [(16, 18), (25, 25)]),
        (["object.right.grid=[16, 18]"], [(12, 20), (16, 18)]),
        (["object.grid=[16, 18]", "object.1.grid=[30, 40]"], [(16, 18), (30, 40)]),
    ],
)
def test_overrides_reach_one_or_all(overrides, expected, folder):
    assert [t.grid for t in symseek.load(folder, overrides).tubes] == expected


def test_overrides_make_tables_and_take_bare_words(folder):
    scene = symseek.load(folder, ["solver.scheme=jacobi", "object.right.material.w02=3e-8", "output.views=false"])
    assert scene.settings.scheme == "jacobi"
    assert [t.material.w02 for t in scene.tubes] == [symseek.Material().w02, 3e-8]
    assert not scene.output.views


def test_projections(folder):
    text = SCENE.replace('units = "mm"\nscale = 0.5\n', "").replace("depth = -2.0", "depth = 5.0")
    text = text[: text.index('[[object]]\nname = "right"')]
    K, R, t = [[100, 0, 40], [0, 100, 32], [0, 0, 1]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 0, 0]
    cases = {
        "orthographic": ("", Camera.orthographic()),
        "stereo": ("alpha = 0.2", Camera.stereo(0.2)),
        "perspective": (f"K = {K}\nR = {R}\nt = {t}", Camera.perspective(*map(np.array, (K, R, t)))),
        "matrix": ("P = [[2, 0, 0, 0], [0, 2, 1, 0], [0, 0, 0, 1]]",
                   Camera(np.array([[2, 0, 0, 0], [0, 2, 1, 0], [0, 0, 0, 1.0]]))),
    }  # fmt: skip
    for name, (keys, camera) in cases.items():
        new = text.replace("[[view]]\n", f'[[view]]\nprojection = "{name}"\n{keys}\n')
        (folder / "scene.toml").write_text(new)
        np.testing.assert_allclose(symseek.load(folder).views[0].camera.matrix, camera.matrix)


@pytest.mark.parametrize("name", cli.demos())
def test_scenes_that_ship_are_good(name):
    scene = symseek.load(cli.demos()[name])
    assert scene.name == name and scene.tubes + scene.lines
    assert cli._about(cli.demos()[name]), "demo --list has nothing to say"


@pytest.mark.parametrize(
    "camera",
    [
        Camera.orthographic(0.3),
        Camera.stereo(-0.2),
        Camera.perspective(np.diag([500.0, 500, 1]), np.eye(3)[[0, 2, 1]] * [1, 1, -1], np.array([0, 0, 9.0])),
    ],
)
def test_front_looks_as_the_camera_does(camera):
    """A step right or down raises column or row of a point's image, a step away leaves it where it is."""
    point = np.array([0.4, -0.3, 0.7])
    frame = files.front(camera, point)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0.99
    here = camera.project(point)
    right, down, away = (camera.project(point + 1e-4 * step) - here for step in frame)
    assert right[0] > 0 and down[1] > 0
    np.testing.assert_allclose(away, 0, atol=1e-9)


def test_public_names():
    for name in symseek.__all__:
        assert getattr(symseek, name) is not None
    assert set(symseek._HOMES) == set(symseek.__all__) - {"__version__"}
    assert symseek.run.__name__ == "run" and callable(symseek.run)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = symseek.nonsense  # pyright: ignore


def test_settings_have_bounds_that_their_defaults_keep():
    from symseek.scene import SETTINGS_BOUNDS

    for name, bound in SETTINGS_BOUNDS.items():
        value = getattr(symseek.Settings(), name)
        if isinstance(value, str):
            assert value in bound
        elif value is not None:
            assert bound[0] <= value <= bound[1]
    assert set(SETTINGS_BOUNDS) == {f.name for f in dataclasses.fields(symseek.Settings)}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"spine": None}, r"reconstruct: object\[0\].spine: is missing"),
        ({"spine": [[1, 2]]}, "has 1 point"),
        ({"spine": [[20, 30], [99, 30]]}, "outside the image of 80 x 64"),
        ({"grid": (3, 3)}, "grid"),
        ({"units": "mm"}, "scale: is missing"),
        ({"settings": {"schem": "adi"}}, "did you mean scheme"),
        ({"material": {"w20": "soft"}}, "a finite number"),
        ({"name": "a/b"}, "file name"),
        ({"device": "abacus"}, "abacus"),
        ({"image": np.zeros((64, 80, 9))}, r"\(64, 80, 9\)"),
        ({"image": np.zeros((0, 80))}, "empty"),
        ({"image": np.full((64, 80), np.nan)}, "NaN"),
        ({"ignore": np.ones((64, 80))}, "whole image"),
    ],
)
def test_script_arguments_are_checked_like_a_file(arguments, expected):
    image = np.add.outer(np.arange(64), np.arange(80)) / 200
    with pytest.raises(symseek.SceneError, match=expected):
        symseek.reconstruct(**{"image": image, "spine": [[20, 30], [60, 30]], **arguments})


LINES = """
[[view]]
image = "photo.png"

[[object]]
name = "edge"
kind = "snake"
closed = false
points = [[10, 12], [40, 20], [70, 14]]
nodes = 40
not_here = [[5, 5]]
[object.material]
w1 = 0.1
w2 = 2e-6

[[object.spring]]
point = 0.25
anchor = [30, 40]
stiffness = 2
start = 10
stop = 20

[[object.spring]]
anchor = [30, 40]
reach = 6

[[object]]
name = "leaf"
kind = "sheet"
corners = [[10, 12], [40, 20], [40, 40], [12, 38]]
depth = 3.0
grid = [9, 7]
load = [0, 0, 1]
image = false

[[object.spring]]
near = [10, 12, 3]
anchor = [0, 0, 9]

[[object]]
name = "body"
spine = [[20, 30], [40, 32], [60, 30]]

[[object.spring]]
point = [0.5, 0.1]
anchor = [30, 40]
"""


def test_snakes_sheets_and_springs(folder):
    (folder / "scene.toml").write_text(LINES)
    scene = symseek.load(folder)
    assert [o.name for o in scene.tubes] == ["body"] and [o.name for o in scene.lines] == ["edge", "leaf"]
    edge, leaf = scene.lines
    assert isinstance(edge, symseek.Snake) and isinstance(leaf, symseek.Sheet)
    assert (edge.closed, edge.nodes, edge.material) == (False, 40, symseek.SnakeMaterial(0.1, 2e-6))
    np.testing.assert_array_equal(edge.points, [[10, 12], [40, 20], [70, 14]])
    assert edge.springs == (
        symseek.Spring((30, 40), point=(0.25,), stiffness=2, start=10, stop=20),
        symseek.Spring((30, 40), reach=6),
    )
    assert (leaf.grid, leaf.load, leaf.image, leaf.depth) == ((9, 7), (0, 0, 1), False, 3)
    assert leaf.springs == (symseek.Spring((0, 0, 9), near=(10, 12, 3)),)
    assert scene.tubes[0].springs == (symseek.Spring((30, 40), point=(0.5, 0.1)),)


def test_a_spring_says_which_view_its_points_are_in(folder):
    """By the view's name; the tube is held beside what that view sees, and no other kind of object knows of it."""
    image = np.zeros((60, 80), np.float32)
    image[20:40, 20:60] = 1
    eyes = [{"name": n, "image": image, "projection": "stereo", "alpha": a} for n, a in (("left", 0.2), ("right", -0.2))]
    spring = {"anchor": [30, 40], "near": [25, 30], "view": "right"}
    tube = {"name": "body", "spine": [[20, 30], [60, 30]], "spring": [spring]}
    assert build({"view": eyes, "object": [tube]}, folder, "pair").tubes[0].springs[0].view == 1
    for wrong, text in (
        ({**tube, "spring": [{**spring, "view": "rigth"}]}, "did you mean right"),
        ({"name": "edge", "kind": "snake", "points": [[20, 20], [60, 20], [40, 50]], "spring": [spring]}, "a snake lies in"),
    ):
        with pytest.raises(symseek.SceneError, match=text):
            build({"view": eyes, "object": [wrong]}, folder, "pair")
