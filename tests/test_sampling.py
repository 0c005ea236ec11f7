"""Colours and samples of an image against other libraries' and against what is between pixels."""

import numpy as np
import pytest
from scipy import ndimage
from skimage import color

from symseek.sim.filters import correlation, derivatives, gaussian, smoothed
from symseek.sim.sampling import colours, resample

RNG = np.random.default_rng(5)


def test_colours_are_lab():
    image = RNG.uniform(size=(70, 50, 3)).astype(np.float32) ** 3
    lab = color.rgb2lab(image.astype(float)) / [100, 180, 180]
    np.testing.assert_allclose(colours(image), lab, atol=1e-3)
    grey = np.repeat(image[..., :1], 3, axis=2)
    np.testing.assert_array_equal(colours(grey), image[..., :1])


def test_whole_pixels_are_those_of_the_image():
    """Samples a pixel apart, from a pixel's centre on, are the pixels; beyond the image its border."""
    image = RNG.uniform(size=(20, 30, 2)).astype(np.float32)
    np.testing.assert_array_equal(resample(image, np.array([3.0, 4.0]), 1.0, (10, 12)), image[4:14, 3:15])
    beyond = resample(image, np.array([3.0, 4.0]), 1.0, (30, 40))[16:, 27:]
    np.testing.assert_allclose(beyond, np.broadcast_to(image[-1, -1], beyond.shape), rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.7, 2.0, 9.0])
def test_filters_are_those_of_scipy(sigma):
    values = RNG.uniform(size=(23, 40))
    expected = ndimage.gaussian_filter(values, sigma, mode="nearest", truncate=3.0)
    np.testing.assert_allclose(smoothed(values, sigma), expected, atol=1e-6)
    once, twice = derivatives(sigma)
    for kernel, rows in zip(
        (once, gaussian(sigma), twice), np.split(correlation(23, once, gaussian(sigma), twice) @ values, 3), strict=True
    ):
        np.testing.assert_allclose(rows, ndimage.correlate1d(values, kernel, 0, mode="nearest"), atol=1e-6)
