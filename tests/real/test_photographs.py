"""Real photographs, from the folder in SYMSEEK_DATA: silhouettes against outlines traced by hand."""

from __future__ import annotations

import pytest

import symseek
from benchmarks import photographs

pytestmark = pytest.mark.skipif(
    not photographs.here(),
    reason="SYMSEEK_DATA does not name the folder with photo_axes.json and the photographs",
)

BARS = {
    "pear_right": 0.93,
    "avocado_9": 0.93,
    "cucumber": 0.93,
    "aubergine": 0.93,
    # 21 px wide, so that the outline's own 1.5 px weigh 0.14: the rocket's plain edges score .78, with its towers .83
    "rocket": 0.80,
    "avocado_cutout": 0.93,
    "lightbulb_cutout": 0.93,
    "corn_cutout": 0.93,
}
"""Least IoU for each photograph."""


@pytest.mark.parametrize("name", BARS)
def test_silhouette(name, record_property):
    scene, truth = photographs.scene_and_outline(name)
    result = symseek.reconstruct(scene)
    iou = photographs.overlap(photographs.silhouette(result), truth)
    record_property("iou", iou)
    assert iou > BARS[name], f"IoU {iou:.3f}; {result.objects[0].warnings}"
    assert result.objects[0].trusted == (iou > 0.93), result.objects[0].warnings
