"""The foreground map on scenes whose object is known."""

import numpy as np
import pytest
from scipy import ndimage

from symseek.sim.assembly import Assembly, maps_of
from symseek.sim.camera import Camera
from symseek.sim.foreground import axis_curve, foreground, length_of, signed_depth
from symseek.sim.problem import Settings, Tube, View

SHAPE, CENTRE, HALF = (200, 240), np.array([120.0, 100.0]), np.array([80.0, 32.0])
AXIS = CENTRE + np.array([[-60, 0], [-30, 0], [0, 0], [30, 0], [60, 0.0]])
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
ELLIPSE = np.hypot((X - CENTRE[0]) / HALF[0], (Y - CENTRE[1]) / HALF[1]) < 1


def _scene(noise=0.03, colour=False, extra=None):
    """The ellipse on a darker ground, with noise; `extra` pixels look like it."""
    rng = np.random.default_rng(7)
    mask = ELLIPSE if extra is None else ELLIPSE | extra
    image = np.where(mask, 0.7, 0.35)
    if colour:  # equal in brightness, unequal in hue
        image = np.where(mask[..., None], [0.7, 0.4, 0.3], [0.35, 0.5, 0.65])
    return np.clip(image + noise * rng.standard_normal(image.shape), 0, 1).astype(np.float32)


def _map(image, axis=AXIS, **marks):
    return foreground(image, axis, **marks).in_image(SHAPE) > 0.5


def _iou(a, b):
    return np.sum(a & b) / np.sum(a | b)


@pytest.mark.parametrize("colour", [False, True])
def test_ellipse_in_noise(colour):
    for noise in (0.03, 0.06):
        assert _iou(_map(_scene(noise, colour)), ELLIPSE) > 0.97


@pytest.mark.parametrize("seed", range(2))
def test_tint_tells_apart_what_lightness_does_not(seed):
    """A greenish ellipse with a highlight along it on grey blocks of all shades."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(0.15, 0.75, (20, 24)), np.ones((10, 10)))
    light = np.where(ELLIPSE, 0.2 + 0.45 * np.exp(-(((Y - 88) / 7) ** 2)), blocks)
    image = light[..., None] * np.where(ELLIPSE[..., None], [0.8, 1.2, 0.8], 1.0)
    noisy = image + 0.02 * rng.standard_normal(image.shape)
    assert _iou(_map(np.clip(noisy, 0, 1).astype(np.float32)), ELLIPSE) > 0.965


def test_contrast_either_way():
    assert _iou(_map(1 - _scene()), ELLIPSE) > 0.97


@pytest.mark.parametrize("seed", range(3))
def test_rough_clicks(seed):
    """Clicks 5 px off, a sixth of the half width, change next to nothing."""
    clicks = AXIS + 5 * np.random.default_rng(seed).standard_normal(AXIS.shape)
    assert _iou(_map(_scene(), clicks), ELLIPSE) > 0.95


def test_size_and_place():
    """Half width at most that of the middle; the axis carried on to the ends of the object."""
    found = foreground(_scene(), AXIS)
    assert found.length == pytest.approx(120, rel=1e-3)
    assert 0.75 * HALF[1] < found.half_width < 1.02 * HALF[1]
    np.testing.assert_allclose(found.axis[[0, -1]], np.add(CENTRE, [[-80, 0], [80, 0]]), atol=4)
    np.testing.assert_allclose(found.axis[:, 1], 100, atol=0.5)


def test_clicks_that_zigzag_give_a_straight_axis():
    clicks = AXIS + np.outer([1, -1, 1, -1, 1], [0, 12])
    found = foreground(_scene(), clicks)
    assert _iou(found.in_image(SHAPE) > 0.5, ELLIPSE) > 0.97
    np.testing.assert_allclose(found.axis[:, 1], 100, atol=2)


def test_clicks_beside_a_thin_object_come_back_to_it():
    """A wave 16 px wide, two of its clicks on the ground beside it."""
    wave = 100 + 20 * np.sin(2 * np.pi * (X[0] - 40) / 160)
    body = (np.abs(Y - wave) < 8) & (np.abs(X - 120) < 80)
    image = np.where(body, 0.7, 0.35) + 0.02 * np.random.default_rng(1).standard_normal(SHAPE)
    columns = np.array([45, 82, 120, 158, 195])
    clicks = np.stack([columns, wave[columns] + [0, 10, 0, -10, 0]], axis=1)
    found = foreground(image.astype(np.float32), clicks)
    assert _iou(found.in_image(SHAPE) > 0.5, body) > 0.9
    inner = found.axis[np.abs(found.axis[:, 0] - 120) < 70]
    np.testing.assert_allclose(inner[:, 1], np.interp(inner[:, 0], X[0], wave), atol=3)


@pytest.mark.parametrize(
    "camera",
    [Camera.stereo(0.2), Camera.perspective(np.diag([500.0, 500.0, 1.0]), np.eye(3), np.array([0, 0, 500.0]))],
)
def test_the_axis_moves_sideways_only(camera):
    """A tilted spine in the world, drawn 10 px off: it moves to the object's middle, and each point keeps its depth."""
    spine = np.stack([np.linspace(60, 180, 5), np.full(5, 110.0), np.linspace(-20, 20, 5)], axis=1)
    seen = axis_curve(camera.project(spine))
    shift = seen.mean(0) - CENTRE - [0, 10]
    moved = Camera(np.array([[1, 0, -shift[0]], [0, 1, -shift[1]], [0, 0, 1]]) @ camera.matrix)
    views, tubes = [View(_scene(), moved)], [Tube(spine)]
    scene = Assembly(views, tubes, Settings(), "cpu", maps_of(views, tubes))
    axis = scene._carried_on(0)
    np.testing.assert_allclose(moved.project(axis), scene.maps[0][0].axis, atol=1e-6)
    inner = np.abs(moved.project(axis)[:, 0] - CENTRE[0]) < 40
    assert np.abs(moved.project(axis)[inner, 1] - CENTRE[1]).max() < 2
    nearest = np.abs(seen[:, 0] - shift[0] - moved.project(axis)[inner][:, :1]).argmin(axis=1)
    depth = moved.distance(axis_curve(spine))[nearest]
    np.testing.assert_allclose(moved.distance(axis[inner]), depth, atol=3)


def test_not_here_cuts_a_neighbour_off():
    """A disc of the same grey that overlaps the ellipse: a mark on it takes most of it away."""
    disc = np.hypot(X - 120, Y - 70) < 20
    image, alone = _scene(extra=disc), disc & ~ELLIPSE
    plain, marked = _map(image), _map(image, not_here=np.array([[120.0, 60.0]]))
    assert np.mean(plain[alone]) > 0.9 and np.mean(marked[alone]) < 0.35
    assert np.mean(marked[ELLIPSE & ~disc]) > 0.95


@pytest.mark.parametrize(("column", "row", "radius"), [(100, 116, 9), (140, 84, 10)])
def test_ignored_pixels_take_after_their_neighbours(column, row, radius):
    """A blotch of the ground's grey on the object is a hole in the map, unless it is not looked at."""
    off = np.hypot(X - column, Y - row)
    image = np.where(off < radius, 0.35, _scene()).astype(np.float32)
    assert np.mean(_map(image)[off < radius]) < 0.2
    ignored = _map(image, ignore=off < radius + 3)
    assert np.mean(ignored[off < radius]) > 0.9 and _iou(ignored, ELLIPSE) > 0.98


def test_map_lies_in_the_image_and_between_0_and_1():
    found = foreground(_scene(), AXIS)
    whole = found.in_image(SHAPE)
    assert whole.shape == SHAPE and whole.min() >= 0 and whole.max() <= 1
    assert whole[100, 120] > 0.9 and whole[20, 20] < 0.1


def test_axis_curve_is_smooth_and_even():
    """Through the points of a quarter circle: length r pi / 2, equal steps."""
    angle = np.linspace(0, np.pi / 2, 5)
    points = 50 * np.stack([np.cos(angle), np.sin(angle)], -1)
    curve = axis_curve(points)
    assert length_of(curve) == pytest.approx(25 * np.pi, rel=1e-3)
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(curve, axis=1), 50, rtol=2e-3)
    np.testing.assert_allclose(axis_curve(points[[0, -1]])[[0, -1]], points[[0, -1]])


@pytest.mark.parametrize("seed", range(6))
def test_signed_depth_is_what_every_pixel_says(seed):
    rng = np.random.default_rng(seed)
    mask = ndimage.gaussian_filter(rng.standard_normal((30, 22)), 3) > (0.08, 0.0, -0.05)[seed % 3]
    own, other = np.argwhere(mask), np.argwhere(~mask)
    grid = np.moveaxis(np.indices(mask.shape), 0, -1)
    away = [np.linalg.norm(grid[:, :, None] - lot, axis=-1).min(axis=2) for lot in (other, own)]
    want = np.where(mask, *(away[0], -away[1]))
    most = rng.uniform(1, 6, mask.shape)
    assert np.allclose(signed_depth(mask), want)
    assert np.allclose(signed_depth(mask, most), np.clip(want, -most, most))
    assert np.array_equal(signed_depth(np.zeros((3, 4), bool), 2.0), np.full((3, 4), -2.0))
    assert np.array_equal(signed_depth(np.ones((3, 4), bool), 2.0), np.full((3, 4), 2.0))
