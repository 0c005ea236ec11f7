"""Colours and samples of an image against other libraries' and against what is between pixels."""

import numpy as np
import pytest
from scipy import ndimage

from symseek.sim.filters import correlation, derivatives, gaussian, smoothed
from symseek.sim.sampling import colours, resample

RNG = np.random.default_rng(5)


def test_colours_are_lab():
    """White, black and pure red (53.24, 80.09, 67.20 by the CIE) over 100, 180, 180; grey stays one channel."""
    image = np.array([[[1, 1, 1], [0, 0, 0], [1, 0, 0]]], np.float32)
    expected = np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20]]) / [100, 180, 180]
    np.testing.assert_allclose(colours(image)[0], expected, atol=2e-4)
    grey = np.repeat(RNG.uniform(size=(70, 50, 1)).astype(np.float32), 3, axis=2)
    np.testing.assert_array_equal(colours(grey), grey[..., :1])


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
