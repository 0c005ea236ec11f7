"""Potentials (11) at a scale, against closed forms of a smoothed edge and of smoothed waves."""

import numpy as np
import pytest

from symseek.sim.camera import Camera
from symseek.sim.foreground import Foreground
from symseek.sim.potential import FINEST_PX, FLOOR, OVER, ScaleSpace, sigma_list
from symseek.sim.problem import Settings, View
from tests import reference


def _space(image, half_width, inside=None, ignore=None, behind=None, **settings):
    """A scale space of the whole image, with a map given on the same pixels."""
    h, w = image.shape
    inside = np.full((h, w), 0.5, np.float32) if inside is None else inside
    axis = np.array([[0.0, h / 2], [w - 1, h / 2]])
    map_ = Foreground(inside, 1.0, (0.0, 0.0), float(w), half_width, axis, behind=behind)
    view = View(image.astype(np.float32), ignore=ignore)
    return ScaleSpace(view, Camera.orthographic(), map_, Settings(**settings))


def _step_image(shape, column, low, high):
    """A vertical edge at a column, pixels shaded by how far they are covered."""
    cover = np.clip(column + 0.5 - np.arange(shape[1]), 0, 1)
    return np.tile(low + (high - low) * cover, (shape[0], 1))


@pytest.mark.parametrize("scale", [1, 2, 4])
@pytest.mark.parametrize("grey", [(0.1, 0.9), (0.55, 0.5)])
def test_pull_is_the_way_to_a_step_edge(scale, grey):
    """sigma^2 grad P / (P + floor) = -x / (1 + floor exp(x^2 / 2 sigma^2)) px, whatever contrast and scale."""
    sigma, column = 10.0 * scale, 60.3 * scale
    space = _space(_step_image((40 * scale, 120 * scale), column, *grey), 32.0 * scale, potential="brightness")
    potential = space.at(sigma)
    row = potential.samples[potential.samples.shape[0] // 2]
    x = potential.origin[0] + potential.step * np.arange(len(row)) - column
    near = np.abs(x) < sigma
    expected = -x / (1 + FLOOR * np.exp(0.5 * (x / sigma) ** 2))
    np.testing.assert_allclose(row[near, 0], expected[near], rtol=0.03, atol=0.01 * sigma)
    np.testing.assert_allclose(row[near, 1:], 0, atol=1e-3)


@pytest.mark.parametrize("half_width", [40.0, 128.0])
def test_paper_force_is_the_gradient_of_11(half_width):
    """I = ramp + sin(kx x) + cos(ky y): G*I damps each wave by exp(-sigma^2 k^2 / 2); P and grad P in image pixels."""
    sigma, k, ramp = 6.0, np.array([0.09, 0.07]), 0.03
    y, x = np.mgrid[:240, :240].astype(float)
    image = ramp * x + 0.2 * np.sin(k[0] * x) + 0.2 * np.cos(k[1] * y)
    potential = _space(image, half_width, potential="brightness", force="paper").at(sigma)
    damp = 0.2 * k * np.exp(-0.5 * sigma**2 * k**2)
    unit = np.sqrt(2 * np.pi) * sigma**3

    def p(at):
        return np.hypot(ramp + damp[0] * np.cos(k[0] * at[0]), damp[1] * np.sin(k[1] * at[1]))

    rows, cols = np.mgrid[30:210:17, 30:210:13]
    inner = ((cols - potential.origin[0]) % potential.step == 0) & ((rows - potential.origin[1]) % potential.step == 0)
    for i, j in zip(rows[inner], cols[inner], strict=True):
        u, v = int((i - potential.origin[1]) / potential.step), int((j - potential.origin[0]) / potential.step)
        at = np.array([j, i], float)
        assert potential.magnitude[u, v] / potential.step == pytest.approx(p(at), abs=0.02 * damp.max())
        exact = unit * reference.gradient(p, at, 1e-4)
        np.testing.assert_allclose(potential.samples[u, v, :2], exact, atol=0.03 * unit * damp.max() * k.max())
    assert inner.sum() > 10 and not potential.samples[..., 2:].any()


def test_pull_never_exceeds_a_few_sigmas_and_is_finite_on_a_flat_image():
    rng = np.random.default_rng(1)
    for image in (np.full((50, 60), 0.4), rng.uniform(size=(50, 60))):
        samples = _space(image, 20.0, potential="brightness").at(4.0).samples
        assert np.all(np.isfinite(samples)) and np.abs(samples).max() <= 3 * 4.0 * 1.001


@pytest.mark.parametrize("ramp", [-0.03, 0.0, 0.15, 0.4])
def test_the_finest_pull_is_to_where_the_object_ends(ramp):
    """A step and beyond it a root of the distance, as a round object's shading: sigma 1 alone lands inside the object.

    Mean over places of the edge within a pixel.
    """
    fine, off = 64, []
    for column in 60 + np.arange(8) / 8:
        x = (np.arange(120 * fine) + 0.5) / fine - 0.5 - column
        shade = np.where(x > 0, 0.3 + ramp * np.sqrt(np.clip(x, 0, 8.0)), 0.0)
        inside = np.tile(np.arange(120) > column, (40, 1)).astype(np.float32)
        space = _space(np.tile(shade.reshape(120, fine).mean(1), (40, 1)), 32.0, inside)
        off.append([_zero(space.at(1.0, finest).samples[20, :, 0], 60) - column for finest in (False, True)])
    plain, finest = np.mean(off, axis=0)
    assert np.sign(np.round(plain, 2)) == np.sign(ramp)
    assert abs(finest) < max(0.15 * abs(plain), 0.01)


@pytest.mark.parametrize(("contrast", "sigma"), [(0.1, 1.0), (0.4, 1.0), (0.1, 6.0)])
def test_over_another_object_the_map_is_believed_less(contrast, sigma):
    """Beside an edge of x floors its word is 1 / (1 + x) of all; over what lies behind less by `OVER`, down to nothing."""
    image = _step_image((120, 120), 60, 0.5, 0.5 - contrast)
    image[:60] = _step_image((60, 120), 60, 1.0, 0.0)
    inside = np.tile(np.arange(120) < 61, (120, 1)).astype(np.float32)
    behind = np.tile(np.arange(120)[:, None] > 60, (1, 120)).astype(np.float32)
    spaces = [_space(image, 60.0, inside, behind=b) for b in (None, behind)]
    for finest in (False, True):
        alone, before = (space.at(sigma, finest) for space in spaces)
        step = int(alone.step)
        alone, before = (made.samples[:, 60 // step] for made in (alone, before))
        np.testing.assert_array_equal(before[:, :2], alone[:, :2])
        np.testing.assert_array_equal(before[: 50 // step], alone[: 50 // step])
        word = 1 / (1 + contrast / FLOOR)
        left = max(word - OVER, 0) / (1 - OVER) if finest else word
        assert before[90 // step, 2] / alone[90 // step, 2] == pytest.approx(left / word, abs=0.03 if finest else 1e-6)


def _zero(row, near):
    """Where a falling row passes zero, near a place."""
    falls = np.flatnonzero((row[:-1] > 0) & (row[1:] <= 0))
    i = falls[np.abs(falls - near).argmin()]
    return i + row[i] / (row[i] - row[i + 1])


def test_nothing_pulls_from_what_is_ignored():
    image = _step_image((60, 120), 60.0, 0.1, 0.9)
    ignore = np.zeros(image.shape, bool)
    ignore[30:] = True
    magnitude = _space(image, 32.0, ignore=ignore, potential="brightness").at(4.0).magnitude
    assert magnitude[:28, 60].min() > 0 and magnitude[32:].max() == 0


def test_the_map_presses_outward_inside_and_inward_outside():
    """A disc of radius 60: sqrt(pi / 2) sigma (2 G*inside - 1), so about the way to its outline; no edges of texture."""
    y, x = np.mgrid[:321, :321] - 160.0
    off = np.hypot(x, y) - 60.0
    inside = np.clip(0.5 - off, 0, 1).astype(np.float32)
    texture = np.where(off > 30, 0.5 + 0.5 * np.sin(x), 0.5)
    space = _space(texture, 60.0, inside)

    def off_at(potential):
        rows, cols = np.indices(potential.magnitude.shape)
        place = np.stack([cols, rows], -1) * potential.step + potential.origin
        return np.hypot(*np.moveaxis(place - 160.0, -1, 0)) - 60.0

    coarse = space.at(12.0)
    at, pressure = off_at(coarse), coarse.samples[..., 2]
    assert np.all(pressure[at < -4] > 0) and np.all(pressure[at > 4] < 0)
    near = np.abs(at) < 6
    # the outline's curvature moves the zero inward by sigma^2 / 2 R = 1.2
    np.testing.assert_allclose(pressure[near], -at[near], atol=2.0)
    assert not coarse.samples[..., :2].any()  # led by the map alone
    fine = space.at(3.0)
    assert fine.magnitude[np.abs(off_at(fine)) > 20].max() == 0


def test_sigmas_fall_to_the_finest():
    for half_width, step in ((20.0, 1.0), (64.0, 1.0), (400.0, 6.25)):
        sigmas = sigma_list(half_width, step, None)
        assert len(sigmas) > 1 and np.all(np.diff(sigmas) < 0)
        assert sigmas[-1] >= FINEST_PX * step and sigmas[0] < half_width
    assert sigma_list(20.0, 1.0, (9.0, 4.0)) == [9.0, 4.0]


def test_picture_says_where_it_lies():
    picture = _space(np.zeros((101, 201)), 128.0, potential="brightness").at(20.0).picture
    assert picture.sigma == 20.0 and picture.extent == (0, 0, 200, 100) and picture.image.shape == (26, 51)


def test_poles_are_pushed_only_where_the_outline_is_not_plain():
    """A bar 80 wide, from column 100 on a spike 4 wide: no push along the bar's sides, full in it, outward in the spike."""
    inside = np.zeros((201, 241), np.float32)
    inside[60:141, :101] = 1
    inside[99:103, :161] = 1
    space = _space(np.zeros(inside.shape), 40.0, inside)
    potential = space.at(1.0)

    def push(row, column):
        x, y = potential.origin
        return potential.samples[row - int(y), column - int(x), 3]

    assert abs(push(60, 50)) < 0.1 * push(100, 50)
    assert push(100, 50) > 2 and push(30, 50) < -2
    assert push(100, 130) > 0.3 * push(100, 50) and push(100, 190) < -2
