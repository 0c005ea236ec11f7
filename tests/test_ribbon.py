"""The ribbon about an axis on scenes whose ribbon is known."""

import numpy as np
import pytest

from symseek.sim.ribbon import ribbon

SHAPE = (140, 180)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
ELLIPSE = np.hypot((X - 90) / 65, (Y - 70) / 24) < 1
LINE = np.stack([np.linspace(30, 150, 200), np.full(200, 70.0)], axis=1)


def _ribbon(odds, line=LINE, image=ELLIPSE):
    return ribbon(image[..., None].astype(np.float32), odds, line)


def _iou(a, b):
    return np.sum(a & b) / np.sum(a | b)


TRUE_ODDS = np.where(ELLIPSE, 2.0, -2.0)


def test_colours_and_edges_of_an_ellipse():
    mask, centre = _ribbon(TRUE_ODDS)
    assert _iou(mask, ELLIPSE) > 0.94
    np.testing.assert_allclose(centre[:, 1], 70, atol=1.5)
    assert centre[0, 0] == pytest.approx(30, abs=1) and centre[-1, 0] == pytest.approx(150, abs=1)


@pytest.mark.parametrize("beside", [-8.0, 8.0])
def test_an_axis_beside_the_middle_comes_back(beside):
    mask, centre = _ribbon(TRUE_ODDS, LINE + np.array([0, beside]))
    assert _iou(mask, ELLIPSE) > 0.9
    np.testing.assert_allclose(centre[4:-4, 1], 70, atol=3)


def test_edges_say_where_colours_say_nothing():
    """Odds of 0 along a third of the axis: with edges the ribbon keeps its width there."""
    silent = np.abs(X - 90) < 20
    mask, _ = _ribbon(np.where(silent, 0.0, TRUE_ODDS))
    assert _iou(mask[silent], ELLIPSE[silent]) > 0.92


def test_a_side_that_looks_like_the_ground_is_filled():
    """Colours of a patch along one edge speak against it; the other side and the edges speak for it."""
    patch = ELLIPSE & (Y > 87) & (np.abs(X - 90) < 25)
    mask, _ = _ribbon(np.where(patch, -2.0, TRUE_ODDS))
    assert np.mean(mask[patch]) > 0.8


def test_a_leak_to_one_side_is_cut():
    """Ground of the object's colour on one side: both sides end at the edges."""
    leak = (Y > 70) & (np.abs(X - 70) < 10)
    mask, _ = _ribbon(np.where(leak, 2.0, TRUE_ODDS))
    assert np.mean(mask[leak & ~ELLIPSE]) < 0.3
