"""Rough axes drawn too short: what a map becomes, on solids and pictures with known truth."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import truth
from benchmarks.accuracy import Case
from symseek.scenes.synthetic import make
from symseek.sim.camera import Camera
from symseek.sim.foreground import Foreground, foreground
from symseek.sim.neighbours import foregrounds
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct
from symseek.sim.whole import whole


def overlap(map_: Foreground, mask: np.ndarray) -> float:
    found = map_.in_image(mask.shape) > 0.5
    return float((found & mask).sum() / (found | mask).sum())


@pytest.mark.parametrize("kind", ["bent", "pear", "vase", "egg"])
def test_a_short_axis_is_carried_on_to_the_ends(kind):
    """Clicks over two fifths of the object give a map of all of it."""
    sample = Case(202, {"kind": kind, "size": 256, "noise": 0.01}, drawn=0.5).sample()
    view = View(sample.image, Camera.orthographic())
    (map_,) = foregrounds(view, [sample.clicks], [None], [0.0])
    assert overlap(map_, sample.mask) > 0.97
    found = reconstruct([view], [Tube(sample.clicks)]).objects[0]
    assert found.trusted
    assert truth.compare(found.vertices, found.faces, sample).iou > 0.98


@pytest.mark.parametrize("kind", ["squash", "egg", "worm"])
def test_a_fair_axis_is_left_as_it_is(kind):
    sample = make(203, kind=kind, size=256, noise=0.01)
    map_ = foreground(sample.image, sample.clicks)
    assert whole(sample.image, sample.clicks, map_, None) is map_


def picture(body: float, size: int = 240) -> tuple[np.ndarray, np.ndarray]:
    """A rod that goes on into a disc of a radius, and an axis along most of the rod."""
    y, x = np.mgrid[:size, :size].astype(float)
    rod = (np.abs(x - 120) < 12) & (y > 30) & (y < 200)
    shape = rod | (np.hypot(x - 120, y - 170) < body)
    image = np.where(shape, 0.7, 0.2) + 0.01 * np.random.default_rng(0).standard_normal((size, size))
    return image.astype(np.float32), np.array([[120.0, 42], [121, 70], [119, 105]])


def test_a_hand_is_not_more_of_its_finger():
    image, axis = picture(60.0)
    map_ = foreground(image, axis)
    assert whole(image, axis, map_, None) is map_
    image, axis = picture(13.0)  # and a mere rod is all one
    map_ = foreground(image, axis)
    longer = whole(image, axis, map_, None)
    ends = longer.axis[:, 1]
    assert abs(ends.min() - 30) < 3 and abs(ends.max() - 200) < 3


def test_neighbours_are_none_of_it():
    """With another object close by, its axis says where that begins: nothing is carried on."""
    image, axis = picture(13.0)
    other = np.array([[120.0, 140], [120, 165], [120, 190]])
    maps = foregrounds(View(image, Camera.orthographic()), [axis, other], [None, None], [0.0, 0.0])
    assert maps[0].in_image(image.shape)[160:, 118:122].max() < 0.5


@pytest.mark.parametrize("seed", [10, 21, 32])
def test_an_axis_reaches_the_ends_of_what_is_nearly_round(seed):
    sample = make(seed, kind="egg", size=256, noise=0.01)
    axis = foreground(sample.image, sample.clicks).axis
    way = (axis[-1] - axis[0]) / np.linalg.norm(axis[-1] - axis[0])
    rows, columns = np.nonzero(sample.mask)
    along = np.stack([columns, rows], axis=1) @ way
    assert abs((axis @ way).min() - along.min()) < 3
    assert abs((axis @ way).max() - along.max()) < 3
