"""Several views: how they share out their pull, axes that all see, rendered rings and pairs, scene files of them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

import symseek
from benchmarks import truth
from symseek.checks import SceneError
from symseek.scenes import views as generator
from symseek.sim.camera import Camera
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct
from symseek.sim.sights import common_axis, spread, triangulated, untold

BEND = np.stack([np.linspace(-40, 40, 60), 10 * np.cos(np.linspace(-1, 1, 60)), 12 * np.sin(np.linspace(-1, 2, 60))], 1)


def _pair(alpha: float = 0.1) -> list[Camera]:
    return [Camera.stereo(alpha), Camera.stereo(-alpha)]


def _solved(made: generator.Views, clicked: tuple[int, int]):
    rough = triangulated([made.clicks[v] for v in clicked], [made.cameras[v] for v in clicked])
    views = [View(i, c, f"eye{v}") for v, (i, c) in enumerate(zip(made.images, made.cameras, strict=True))]
    return reconstruct(views, [Tube(rough)]).objects[0]


@pytest.mark.parametrize("alpha", [0.02, 0.1, 1.0])
def test_all_views_together_hold_each_direction_alike(alpha):
    """Forces P_v e of a displacement e, spread over nodes and in depth over the ring, sum up to e times one stiffness."""
    sights = np.array([[c.sight(np.zeros(3)) for c in _pair(alpha)]])
    by_node, by_ring, told = spread(sights, np.ones((1, 2)))
    planes = sum(np.eye(3) - np.outer(i, i) for i in sights[0])
    whole = by_node[0] @ planes
    np.testing.assert_allclose(whole + by_ring[0] @ whole, whole[0, 0] * np.eye(3), atol=1e-9)
    assert told[0] and np.abs(by_node).max() <= 1.0 + 1e-9


def test_views_from_one_side_do_not_tell_depth():
    sights = np.tile([0.0, 0.0, 1.0], (1, 3, 1))
    by_node, by_ring, told = spread(sights, np.ones((1, 3)))
    assert not told[0]
    np.testing.assert_allclose(by_node[0], np.eye(3) / 3, atol=1e-12)
    np.testing.assert_allclose(by_ring[0], 0, atol=1e-12)


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [((0, 45, 90, 135), 0.0), ((0, 60, 120), 0.2), ((0, 120, 240), 0.2), ((0, 10), 1.0), ((0, 90), 0.6), ((0,), 1.0)],
)
def test_the_widest_gap_between_contours_says_what_symmetry_must(degrees, expected):
    """Of views round a vertical axis; those from opposite sides show the same contour; gaps from 45 to 120 degrees."""
    angle = np.radians(degrees)
    sights = np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])
    spine = np.column_stack([np.zeros(5), np.arange(5.0), np.zeros(5)])
    np.testing.assert_allclose(untold(np.tile(sights, (5, 1, 1)), spine), expected, atol=1e-6)
    above = np.tile(np.vstack([sights, [0, 1.0, 0]]), (5, 1, 1))  # a view along the axis shows nothing of it
    np.testing.assert_allclose(untold(above, spine), expected, atol=1e-6)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize(("axis", "near", "far"), [(BEND[:, [1, 0, 2]], 1.0, 1.0), (BEND, 2.5, 2.5)])
def test_axis_that_all_views_see_is_found_from_a_rough_one(perspective, axis, near, far):
    """From 6 units off in depth and short at both ends, by the projections of the true one.

    Where it runs along the eyes' own line, its ends and its bend alone tell.
    """
    K = np.array([[900.0, 0, 0], [0, 900, 0], [0, 0, 1]])
    turned = [generator.turn_y(a) for a in (-0.1, 0.1)]
    cameras = [Camera.perspective(K, r, np.array([0, 0, 400.0])) for r in turned] if perspective else _pair()
    rough = axis[8:-8] + np.array([0.5, -0.5, 6.0])
    found = common_axis(rough, cameras, [c.project(axis) for c in cameras])
    assert KDTree(found).query(axis)[0].max() < near
    by_clicks = triangulated([c.project(axis[::10]) for c in cameras], cameras)
    assert KDTree(by_clicks).query(axis[:51])[0].max() < far


def test_axis_of_what_is_stubby_does_not_bend_as_its_clicks_do():
    """Clicks and maps that lie off by a px tell eyes of 6 degrees a zigzag in depth; what is slender may have it."""
    straight = np.column_stack([np.linspace(-30, 30, 61), np.linspace(-40, 40, 61), np.zeros(61)])
    waves = np.sin(np.linspace(0, 5 * np.pi, 61))
    cameras = _pair()
    rough = straight + waves[:, None] * [0, 0, 8.0]
    seen = [
        camera.project(straight) + sign * waves[:, None] * [0.4, 0] for camera, sign in zip(cameras, (1, -1), strict=True)
    ]
    found, bent = (common_axis(rough, cameras, seen, slender) for slender in (1.2, 9.0))
    assert KDTree(straight).query(found)[0].max() < 2 and KDTree(straight).query(bent)[0].max() > 3


@pytest.mark.parametrize(("seed", "kind", "perspective"), [(131, "egg", False), (175, "egg", True), (124, "peanut", True)])
def test_stubby_solids_are_found_by_a_pair_from_poor_axes(seed, kind, perspective):
    """Short ones, or in a zigzag: their end rings grew past the object and folded."""
    made = generator.pair(seed, perspective, kind=kind)
    found = _solved(made, (0, 1))
    assert found.trusted
    assert truth.to_surface(found.vertices, (made.vertices, made.faces)).mean() < 0.002 * made.length


@pytest.mark.parametrize("perspective", [False, True])
def test_a_pair_of_eyes_finds_true_depth(perspective):
    made = generator.pair(2, perspective, kind="bent", size=256)
    found = _solved(made, (0, 1))
    _, near = KDTree(made.spine).query(found.spine[0])
    depth = np.abs((found.spine[0] - made.spine[near])[:, 2])
    assert found.trusted and np.median(depth) < 0.004 * made.length
    away = truth.to_surface(found.vertices, (made.vertices, made.faces)).mean()
    assert away < 0.002 * made.length
    for camera, cover in zip(made.cameras, made.coverages, strict=True):
        assert truth.silhouette_iou(found.vertices, found.faces, camera, cover) > 0.99


def test_a_ring_of_views_measures_each_and_is_nearer_than_a_pair():
    made = generator.ring(3, 3, kind="squash", size=256)
    found = _solved(made, (0, 1))
    away = truth.to_surface(found.vertices, (made.vertices, made.faces)).mean()
    assert away < 0.001 * made.length
    assert abs(found.measures["volume"] / made.volume - 1) < 0.01
    assert list(found.measures["views"]) == ["eye0", "eye1", "eye2"] and len(found.seen) == 3
    shares = [own["supported_share"] for own in found.measures["views"].values()]
    assert min(shares) <= found.measures["supported_share"] <= max(shares)
    assert found.measures["map_agreement"] == min(own["map_agreement"] for own in found.measures["views"].values())


def test_views_all_around_tell_sections_out_of_round():
    made = generator.ring(2, 8, kind="pear", size=256, out_of_round=0.05)
    found = _solved(made, (0, 2))
    away = truth.to_surface(found.vertices, (made.vertices, made.faces)).mean()
    assert found.trusted and away < 0.0012 * made.length  # circles are 0.42 % off
    assert abs(found.measures["volume"] / made.volume - 1) < 0.006


def test_a_worm_in_a_ring_of_views_does_not_roll_up():
    made = generator.ring(105, 8, kind="worm", size=256)
    found = _solved(made, (0, 2))
    assert found.trusted
    assert truth.to_surface(found.vertices, (made.vertices, made.faces)).mean() < 0.001 * made.length


def test_rendered_views_agree_with_their_meshes():
    made = generator.ring(5, 2, perspective=True, size=128)
    for camera, cover, image in zip(made.cameras, made.coverages, made.images, strict=True):
        np.testing.assert_allclose(truth.silhouette(made.vertices, made.faces, camera, cover.shape), cover, atol=0.02)
        assert image[cover == 1].min() > image[cover == 0].max()


def test_shipped_ring_is_measured_as_it_is(tmp_path):
    folder = Path(generator.__file__).parent / "squash_ring"
    result = symseek.run(folder, tmp_path, overrides=["output.video=false", "output.views=false"])
    true = np.load(folder / "truth.npz")
    assert result.objects[0].trusted
    assert abs(result.objects[0].measures["volume"] / float(true["volume"]) - 1) < 0.01
    away = truth.to_surface(result.objects[0].vertices, (true["vertices"], true["faces"].astype(int))).mean()
    assert away < 0.001 * float(true["length"])
    assert (tmp_path / "overlay.png").is_file()


def test_a_ring_from_a_script():
    folder = Path(generator.__file__).parent / "squash_ring"
    scene = symseek.load(folder)
    views = [{"name": v.name, "image": v.image, "projection": "matrix", "P": v.camera.matrix} for v in scene.views]
    spine = np.load(folder / "truth.npz")["spine"][[10, 35, 65, 90]]
    settings = {"iterations": 3}
    found = symseek.reconstruct(views=views, spine=spine, name="squash", units="mm", settings=settings)
    assert found.scene.units == "mm" and [v.name for v in found.scene.views] == [v.name for v in scene.views]
    assert len(found.objects[0].seen) == 8
    np.testing.assert_array_equal(found.scene.tubes[0].spine, spine)
    spines = scene.text["object"][0]["spines"]
    found = symseek.reconstruct(views=views, spines=spines, settings=settings)
    np.testing.assert_array_equal(found.scene.tubes[0].spine, scene.tubes[0].spine)
    for wrong in ({}, {"image": views[0]["image"], "views": views}, {"views": views, "ignore": np.zeros((9, 9))}):
        with pytest.raises(TypeError, match="give"):
            symseek.reconstruct(**wrong, spine=spine)


def _scene(spines: str, second: str = 'projection = "stereo"\nalpha = -0.2', first: str = "") -> dict:
    import tomllib

    image = np.zeros((60, 80), np.float32)
    image[20:40, 20:60] = 1
    data = tomllib.loads(f'[[view]]\nname = "left"\n{first}\n[[view]]\nname = "right"\n{second}\n[[object]]\n{spines}')
    for view in data["view"]:
        view["image"] = image
    return data


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("spines.left = [[20, 30], [60, 30]]", ["object[0].spines", "holds 1 axes", "'left' and 'right'"]),
        ("spines.top = [[20, 30], [60, 30]]", ["object[0].spines.top", "unknown key", "left, right"]),
        ("spines.left = [[20, 30], [60, 30]]\nspine = [[20, 30], [60, 30]]", ["object[0].spines", "beside spine"]),
        ("spines = { left = [[20, 30], [60, 30]], right = [[20, 30], [600, 30]] }", ["spines.right[1]", "outside"]),
        ("spine = [[20, 30, 600], [60, 30, 600]]", ["object[0].spine", "0% of it", "'right'"]),
    ],
)
def test_axes_that_do_not_fit_their_views_are_refused(text, expected):
    with pytest.raises(SceneError) as raised:
        symseek.scene.build(_scene(text), Path(), "pair.toml")
    for words in expected:
        assert words in str(raised.value)


def test_two_views_of_one_name_are_refused():
    data = _scene("spine = [[20, 30], [60, 30]]")
    data["view"][1]["name"] = "left"
    with pytest.raises(SceneError, match=r"view\[1\].name: 'left' stands twice"):
        symseek.scene.build(data, Path(), "pair.toml")
