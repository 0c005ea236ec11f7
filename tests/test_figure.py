"""Figures: tubes united into one solid, against closed forms."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import symseek
from symseek.checks import SceneError
from symseek.scene import build
from symseek.scenes import dancers
from symseek.sim.figure import unite
from symseek.sim.initial import initial_tube
from symseek.sim.surface import refine


def sphere(centre, radius):
    mesh = trimesh.creation.icosphere(5, radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


def capsule(ends, radius):
    """The mesh of a tube of ours with round ends, from the one point to the other."""
    first, last = np.array(ends, float)
    step = radius * (last - first) / np.linalg.norm(last - first)
    return refine(initial_tube(np.array([first - step, last + step]), radius, (48, 96), True)[0], 96, 800)


def watertight(figure):
    mesh = trimesh.Trimesh(figure.vertices, figure.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(figure.volume, rel=1e-9) and mesh.area == pytest.approx(figure.area, rel=1e-9)
    return mesh.body_count


@pytest.mark.parametrize("d", [0.3, 1.2, 1.9])
def test_union_of_two_spheres(d):
    """V = 2 (4/3 pi) - pi (4 + d) (2 - d)^2 / 12, A = 4 pi (1 + d / 2), radii 1, centres d apart."""
    figure = unite("pair", ["a", "b"], [sphere((5, 0, 0), 1), sphere((5 + d, 0, 0), 1)])
    assert watertight(figure) == 1 and figure.pieces == [[0, 1]] and not figure.warnings
    assert figure.volume == pytest.approx(8 / 3 * np.pi - np.pi * (4 + d) * (2 - d) ** 2 / 12, rel=2e-3)
    assert figure.area == pytest.approx(4 * np.pi * (1 + d / 2), rel=2e-3)


def test_union_of_crossed_tubes_of_ours():
    """Two cylinders of radius r at right angles share Steinmetz' 16 r^3 / 3; a capsule holds pi r^2 L + 4/3 pi r^3."""
    r, half = 1.0, 3.0
    one, other = capsule([(-half, 0, 0), (half, 0, 0)], r), capsule([(0, -half, 0), (0, half, 0)], r)
    figure = unite("cross", ["a", "b"], [one, other])
    assert watertight(figure) == 1
    each = np.pi * r**2 * 2 * half + 4 / 3 * np.pi * r**3
    assert figure.volume == pytest.approx(2 * each - 16 / 3 * r**3, rel=3e-3)


def test_what_does_not_touch_is_said():
    parts = [sphere((x, 0, 0), radius) for x, radius in ((9, 0.5), (0, 1), (1, 1), (9.7, 0.5), (20, 0.2))]
    figure = unite("five", list("abcde"), parts)
    assert watertight(figure) == 3 and figure.pieces == [[1, 2], [0, 3], [4]]
    assert [w.split(" does")[0] for w in figure.warnings] == ["a and d", "e"]
    with pytest.raises(ValueError, match="b is no closed surface"):
        unite("torn", ["a", "b"], [parts[0], (parts[1][0], parts[1][1][1:])])


def test_tubes_of_a_figure_become_its_files(tmp_path):
    """Two discs' worth of bars that cross, dark on light and light on dark: the same solid."""
    rows, columns = np.mgrid[:160, :200]
    bar, post = (_from_segment(columns, rows, *ends) for ends in (((40, 80), (160, 80)), ((100, 30), (100, 130))))
    ink = np.clip(14.5 - np.minimum(bar, 0.9 * post), 0, 1)
    volumes = []
    for image in (1 - ink, ink):
        Image.fromarray(np.uint8(255 * image)).save(tmp_path / "cross.png")
        (tmp_path / "scene.toml").write_text(
            '[[view]]\nimage = "cross.png"\n[output]\nvideo = false\n'
            '[[object]]\nname = "bar"\nfigure = "cross"\nspine = [[30, 80], [100, 80], [170, 80]]\n'
            '[[object]]\nname = "post"\nfigure = "cross"\nspine = [[100, 20], [100, 80], [100, 140]]\n'
            '[[object]]\nname = "aside"\nspine = [[100, 20], [100, 140]]\n'
        )
        result = symseek.run(tmp_path, tmp_path / "out", callback=lambda p: p.iteration >= 60)
        record = json.loads((tmp_path / "out" / "result.json").read_text())
        assert record["figures"]["cross"]["tubes"] == ["bar", "post"] and len(record["figures"]["cross"]["pieces"]) == 1
        mesh = trimesh.load_mesh(tmp_path / "out" / "cross.ply", process=False)
        assert mesh.is_watertight and mesh.volume == pytest.approx(record["figures"]["cross"]["volume"], rel=1e-5)
        single = [o.measures["volume"] for o in result.objects[:2]]
        assert max(single) < mesh.volume < sum(single)
        assert {"cross.glb", "bar.ply", "stages.png"} <= set(record["files"]) and not record["skipped"]
        volumes.append(mesh.volume)
    assert volumes[1] == pytest.approx(volumes[0], rel=0.02)


def _from_segment(x, y, first, last):
    (a, b), (c, d) = first, last
    t = np.clip(((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2), 0, 1)
    return np.hypot(x - a - t * (c - a), y - b - t * (d - b))


def test_a_figure_is_named_like_no_object(tmp_path):
    bar = {"name": "bar", "spine": [[20, 30], [60, 30]]}
    view = [{"image": np.tile(np.linspace(0, 1, 80), (60, 1))}]
    for figure, words in (("bar", "is an object's name"), ("a/b", "cannot be a file name"), (3, "is not text")):
        with pytest.raises(SceneError, match=words) as error:
            build({"view": view, "object": [bar | {"figure": figure}]}, tmp_path, "test")
        assert error.value.field == "object[0].figure"
    snake = {"name": "eel", "kind": "snake", "figure": "x", "points": [[20, 20], [60, 20], [40, 50]]}
    with pytest.raises(SceneError, match="does not belong to a snake"):
        build({"view": view, "object": [snake]}, tmp_path, "test")


def test_the_dance_is_what_its_script_draws():
    scene = symseek.load(dancers.FOLDER)
    np.testing.assert_array_equal(np.rint(255 * scene.views[0].image), np.rint(255 * dancers.picture()))
    assert len(scene.tubes) >= 43 and {tube.figure for tube in scene.tubes} == set(dancers.STROKES)
    for tube in scene.tubes:  # axes start and end on their figures' ink, within a hand's shake
        ink = dancers.figure(tube.figure)
        for column, row in np.rint(tube.spine).astype(int):
            assert ink[row - 4 : row + 5, column - 4 : column + 5].max() == 1.0, tube.name
