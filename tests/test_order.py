"""Depth order found from the image, against pictures painted in a known order."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

import symseek
from symseek.scene import build
from symseek.scenes.still_life import make
from symseek.sim.order import in_order
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct

SHAPE = 200, 240
LYING, UPRIGHT, SLANTED = (
    np.array([[50.0, 70], [190, 70]]),
    np.array([[80.0, 30], [80, 170]]),
    np.array([[70.0, 150], [185, 50]]),
)
RED, GREEN, BLUE = (0.8, 0.25, 0.2), (0.25, 0.7, 0.3), (0.3, 0.35, 0.85)


def _bar(axis: np.ndarray, half: float = 15.0) -> np.ndarray:
    """Pixels nearer than `half` to a straight axis."""
    rows, columns = np.indices(SHAPE)
    points, way = np.stack([columns, rows], axis=-1) - axis[0], axis[1] - axis[0]
    t = np.clip(points @ way / (way @ way), 0, 1)
    return np.linalg.norm(points - t[..., None] * way, axis=-1) < half


def _painted(*layers: tuple[np.ndarray, tuple[float, float, float]]) -> View:
    """Layers painted one over the other on a dark ground, with a little noise."""
    image = np.full((*SHAPE, 3), 0.08)
    for mask, colour in layers:
        image[mask] = colour
    noise = 0.01 * np.random.default_rng(0).standard_normal(image.shape)
    return View(np.clip(image + noise, 0, 1).astype(np.float32))


def _tubes(**axes: np.ndarray) -> list[Tube]:
    return [Tube(axis, name=name, find_depth=True) for name, axis in axes.items()]


@pytest.mark.parametrize("swapped", [False, True])
def test_of_two_bars_the_one_painted_last_is_in_front(swapped):
    layers = [(_bar(LYING), RED), (_bar(UPRIGHT), GREEN)]
    (lying, upright), found = in_order(_painted(*layers[:: -1 if swapped else 1]), _tubes(lying=LYING, upright=UPRIGHT))
    assert (lying.depth < upright.depth) == swapped and not lying.find_depth
    assert abs(lying.depth - upright.depth) > 15 + 15
    assert all(f is not None and f.certainty > 0.3 and not f.unsure for f in found)


def test_silhouettes_do_not_tell(tmp_path):
    """A cross of one grey: the run says that it does not know, in the record and in each object's warnings."""
    Image.fromarray(np.uint8(255 * _painted((_bar(LYING) | _bar(UPRIGHT), (0.7, 0.7, 0.7))).image)).save(tmp_path / "x.png")
    objects = [{"name": n, "spine": a.tolist(), "depth": "auto"} for n, a in (("lying", LYING), ("upright", UPRIGHT))]
    out = {"overlay": False, "views": False, "video": False, "meshes": False, "potentials": False}
    result = symseek.reconstruct(tmp_path / "x.png", objects=objects, settings={"iterations": 50}, output=out)
    result.save(tmp_path / "out")
    record = json.loads((tmp_path / "out" / "result.json").read_text())["objects"]
    for name, other in (("lying", "upright"), ("upright", "lying")):
        assert not record[name]["trusted"] and record[name]["depth_certainty"] < 0.05
        assert any(other in w and "give depths" in w for w in record[name]["warnings"])


def test_given_depths_stay_and_others_go_between():
    layers = (_bar(LYING), RED), (_bar(SLANTED), BLUE), (_bar(UPRIGHT), GREEN)
    lying, slanted, upright = _tubes(lying=LYING, slanted=SLANTED, upright=UPRIGHT)
    back, front = (dataclasses.replace(t, depth=d, find_depth=False) for t, d in ((lying, 40.0), (upright, 20.0)))
    (a, b, c), found = in_order(_painted(*layers), [back, slanted, front])
    assert (a.depth, c.depth) == (40.0, 20.0) and 20 < b.depth < 40
    assert found[0] is None and found[2] is None and found[1] is not None and not found[1].unsure
    (a, b, c), _ = in_order(_painted(*layers), [lying, slanted, upright])
    assert c.depth < b.depth < a.depth


def test_a_ring_of_bars_is_no_order():
    """Each of three bars over the next: at least one pair is told to be unsure."""
    a, b, c = (_bar(axis) for axis in (LYING, UPRIGHT, SLANTED))
    rows, _ = np.indices(SHAPE)
    view = _painted((a, RED), (b, GREEN), (c, BLUE), (a & c, RED), (a & b, GREEN), (b & c & (rows > 100), BLUE))
    _, found = in_order(view, _tubes(lying=LYING, upright=UPRIGHT, slanted=SLANTED))
    assert sum(f is not None and len(f.unsure) > 0 for f in found) >= 2


def test_apart_there_is_nothing_to_find():
    low = LYING + np.array([0, 90])
    view = _painted((_bar(LYING), RED), (_bar(low), GREEN))
    tubes, found = in_order(view, _tubes(high=LYING, low=low))
    assert [t.depth for t in tubes] == [0.0, 0.0] and all(f is not None and f.certainty == 1 for f in found)
    given = [Tube(LYING), Tube(low)]
    assert in_order(view, given)[0] == given


@pytest.mark.parametrize("seed", [31, 32])
def test_still_life(seed):
    """Found depths serve the reconstruction as given ones do; one object keeps its place as the only one."""
    life = make(seed, size=256, kinds=("egg", "pear"))
    tubes = [Tube(life.back.clicks, name="back", find_depth=True), Tube(life.front.clicks, name="front", find_depth=True)]
    settings = symseek.Settings(iterations=30)
    back, front = reconstruct([View(life.image)], tubes, settings).objects
    assert front.measures["depth"] < back.measures["depth"] and front.measures["depth_certainty"] > 0.05
    assert front.measures["hidden_share"] == 0 < back.measures["hidden_share"]
    assert front.spine[..., 2].mean() < back.spine[..., 2].mean()


def test_bad_input(tmp_path):
    """Words other than "auto", and views and spines whose depth is no matter of order."""
    Image.fromarray(np.uint8(255 * _painted((_bar(LYING), RED)).image)).save(tmp_path / "x.png")
    K = [[300.0, 0, 120], [0, 300, 100], [0, 0, 1]]
    seen_from = {"projection": "perspective", "K": K, "R": np.eye(3).tolist(), "t": [0.0, 0, 0]}
    world = np.column_stack([LYING, [0.0, 0.0]])
    for depth, view, spine, match in (
        ("front", {}, LYING, "finite number"),
        ("auto", seen_from, LYING, "perspective"),
        ("auto", {}, world, "world points"),
    ):
        data = {"view": [{"image": "x.png"} | view], "object": [{"name": "bar", "spine": spine.tolist(), "depth": depth}]}
        with pytest.raises(symseek.SceneError, match=match):
            build(data, tmp_path, "test")
