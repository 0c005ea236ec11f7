"""Maps and tubes of several objects in one picture: still lifes with known truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import symseek
from benchmarks import still_life as bench
from benchmarks import truth
from symseek import cli
from symseek.device import start_quietly
from symseek.scenes.still_life import HIDDEN, StillLife, make
from symseek.sim.camera import Camera
from symseek.sim.foreground import foreground
from symseek.sim.neighbours import completed, foregrounds
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct


@pytest.fixture(scope="module")
def life() -> StillLife:
    return make(0, size=256, kinds=("egg", "pear"))


def test_the_picture_is_what_it_says(life):
    """What the front solid covers of the back one is the share told; clicks lie on the axes; solids do not touch."""
    assert np.minimum(life.front.coverage, life.back.coverage).sum() / life.back.coverage.sum() == life.hidden
    for seed in range(20, 26):
        one = make(seed, size=64)
        assert HIDDEN[0] - 0.03 < one.hidden < HIDDEN[1] + 0.03
        for sample in (one.front, one.back):
            assert sample.coverage[[0, -1]].max() == sample.coverage[:, [0, -1]].max() == 0
            gap = np.linalg.norm(sample.clicks[:, None] - sample.spine[None, :, :2], axis=2).min(axis=1)
            assert gap.max() < 3
    front, back = life.front.vertices[:, 2], life.back.vertices[:, 2] + life.depth
    assert front.max() < back.min()


def test_alone_or_far_apart_nothing_changes(life):
    view = View(life.image)
    alone = foreground(life.image, life.front.clicks)
    np.testing.assert_array_equal(foregrounds(view, [life.front.clicks], [None], [0.0])[0].inside, alone.inside)
    wide = np.concatenate([life.image, life.image[:, ::-1]], axis=1)
    far = life.front.clicks * [-1, 1] + [2 * 256 - 1, 0]
    pair = foregrounds(View(wide), [life.front.clicks, far], [None, None], [0.0, 1.0])
    single = foreground(wide, life.front.clicks)
    np.testing.assert_array_equal(pair[0].inside, single.inside)


def test_front_map_leaves_what_is_behind_and_back_map_goes_on(life):
    maps = foregrounds(View(life.image), [life.front.clicks, life.back.clicks], [None, None], [0.0, life.depth])
    front, back = (map_.in_image((256, 256)) for map_ in maps)
    front, back = front > 0.5, back > 0.5
    assert truth.overlap(front, life.front.coverage > 0.5) > 0.95
    clear = life.front.coverage < 0.5
    assert truth.overlap(back & clear, (life.back.coverage > 0.5) & clear) > 0.95
    assert truth.overlap(back & ~clear, (life.back.coverage > 0.5) & ~clear) > 0.5


def test_a_front_map_knows_what_lies_behind(life):
    """Where that is or nearly is, seen or covered; one of the same depth has nothing behind it, nor has the last."""
    view, axes, marks = View(life.image), [life.front.clicks, life.back.clicks], [None, None]
    front, back = foregrounds(view, axes, marks, [0.0, 1.0])
    assert back.behind is None and all(m.behind is None for m in foregrounds(view, axes, marks, [0.0, 0.0]))
    assert front.behind is not None
    on = np.argwhere(np.abs(front.inside - 0.5) < 0.2)
    column, row = (on[:, ::-1] * front.step + front.origin).astype(int).T
    off = np.asarray(ndimage.distance_transform_edt(life.back.coverage < 0.5))[row, column] / front.half_width
    told = front.behind[tuple(on.T)] > 0.5
    assert told[off == 0].all() and (off == 0).any() and not told[off > 0.4].any() and (off > 0.4).sum() > 20


def test_same_colour_is_parted_by_the_axes():
    """A cross of one grey: each bar's map, told of the other's axis, is that bar; alone, a map takes both."""
    rows, columns = np.mgrid[:200, :200]
    upright = (np.abs(columns - 100) < 12) & (np.abs(rows - 100) < 80)
    level = (np.abs(rows - 60) < 12) & (columns > 100) & (columns < 180)
    image = np.where(upright | level, 0.1, 0.9).astype(np.float32)
    axes = [np.array([[100.0, 30], [100, 170]]), np.array([[112.0, 60], [175, 60]])]
    both = foregrounds(View(image), axes, [None, None], [0.0, 0.0])
    body, limb = (map_.in_image(image.shape) > 0.5 for map_ in both)
    assert truth.overlap(body, upright) > 0.85
    assert truth.overlap(limb, level & ~upright) > 0.75
    assert (body & limb).sum() < 0.1 * limb.sum()


def test_parts_that_join_in_one_colour_are_trusted_with_each_other():
    """No edge parts a limb from its body: what its map has of the body counts against it until the body is a tube, too."""
    rows, columns = np.mgrid[:240, :240]
    along, across = (columns - 170) * 0.94 + (rows - 150) * 0.34, (rows - 150) * 0.94 - (columns - 170) * 0.34
    body = ((columns - 90) / 36) ** 2 + ((rows - 120) / 100) ** 2 < 1
    limb = (along / 62) ** 2 + (across / 13) ** 2 < 1
    image = np.where(body | limb, 0.1, 0.9).astype(np.float32)
    tubes = [Tube(np.array([[90.0, 40], [90, 200]]), name="body"), Tube(np.array([[128.0, 135], [220, 168]]), name="limb")]
    together = reconstruct([View(image)], tubes).objects
    assert all(o.trusted for o in together), [o.warnings for o in together]
    alone = reconstruct([View(image)], tubes[1:]).objects[0]
    assert together[1].measures["map_certainty"] > alone.measures["map_certainty"] + 0.01


def test_completed_end_is_a_ball_about_the_last_point():
    """A bar 40 px wide that runs under a square: it goes on as wide as it was, rounded beyond the last point drawn."""
    rows, columns = np.mgrid[:160, :300]
    bar = (np.abs(rows - 80) < 20) & (columns > 20) & (columns < 300)
    hides = columns > 150
    image = np.where(hides, 0.5, np.where(bar, 0.9, 0.1)).astype(np.float32)
    given = np.column_stack([np.linspace(40, 210, 100), np.full(100, 80.0)])
    map_ = completed(foreground(image, given, hides), given, hides)
    found = map_.in_image(image.shape) > 0.5
    expected = bar & (columns < 210) | (np.hypot(columns - 210, rows - 80) < 20)
    assert truth.overlap(found, expected) > 0.93
    assert map_.guess is not None
    assert map_.axis[:, 0].max() > 220 and abs(map_.half_width - 20) < 2
    untouched = foreground(image, given)
    assert completed(untouched, given, np.zeros(image.shape, bool)) is untouched


def test_the_hidden_part_is_completed_and_the_front_is_as_alone(life):
    """By either way of looking; with visibility off the hidden object is worse."""
    start_quietly()
    scores = {way: bench.score(life, bench.solve(life, way)) for way in ("rays", "off")}
    good = scores["rays"]
    assert good.whole > 0.97 and good.covered > 0.75 and good.surface < 0.3 and good.contour < 0.3
    assert scores["off"].whole < good.whole - 0.01 and scores["off"].surface > 2 * good.surface
    alone = reconstruct([View(life.image)], [Tube(life.front.clicks)]).objects[0]
    assert good.front > 0.98 and good.front >= truth.compare(alone.vertices, alone.faces, life.front).iou - 0.005


def test_what_is_masked_is_completed_as_what_a_tube_hides(life):
    """The front object in a mask instead: the back one goes on below it, and its contour there counts as hidden."""
    mask = ndimage.binary_dilation(life.front.coverage > 0)
    (found,) = reconstruct([View(life.image, ignore=mask)], [Tube(life.back.clicks)]).objects
    assert truth.compare(found.vertices, found.faces, life.back).iou > 0.97
    assert 0.02 < found.measures["hidden_share"] < 0.5 and found.trusted
    column, row = np.clip(np.rint(np.concatenate(found.contour)).astype(int), 0, 255).T
    assert mask[row, column][np.concatenate(found.hidden)].mean() > 0.7


def test_hidden_contour_is_told(life):
    front, back = bench.solve(life, "rays")
    assert front.measures["hidden_share"] == 0 and 0.02 < back.measures["hidden_share"] < 0.5
    points, flags = np.concatenate(back.contour), np.concatenate(back.hidden)
    column, row = np.clip(np.rint(points).astype(int), 0, 255).T
    assert (life.front.coverage[row, column] > 0.5)[flags].mean() > 0.7
    assert (life.front.coverage[row, column] > 0.5)[~flags].mean() < 0.05
    assert back.measures["supported_share"] > 0.9


def test_the_scene_that_ships():
    """Order found, both trusted, silhouettes as the truth beside it says, the hidden part too."""
    path = cli.demos()["pear_potato"]
    true = np.load(path.parent / "truth.npz")
    found = {o.name: o for o in symseek.reconstruct(symseek.load(path)).objects}
    assert found["pear"].measures["depth"] > found["potato"].measures["depth"]
    for name, o in found.items():
        assert o.trusted and o.converged
        silhouette = truth.silhouette(o.vertices, o.faces, Camera.orthographic(), true[f"{name}_coverage"].shape)
        assert truth.overlap(silhouette, true[f"{name}_coverage"] / 255) > 0.985
        assert o.measures["volume"] == pytest.approx(float(true[f"{name}_volume"]), rel=0.03)
