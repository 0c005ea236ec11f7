"""Lens distortion: images and image points as a pinhole camera would have them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy import ndimage

BENT = 1e-9
"""Coefficients that are all smaller are no distortion."""


class Lens:
    """What bends an image, by COLMAP's models, among which OpenCV's; computed by pycolmap.

    The straight image has the size, focal lengths and principal point of the bent one. Image points are (column, row),
    pixel centres at whole numbers.

    Args:
        model: COLMAP's name, as "OPENCV".
        parameters: in COLMAP's order and convention, in which the first pixel's centre is (0.5, 0.5).
        size: width, height of the image [px].

    Raises:
        ImportError: pycolmap is not there.
        ValueError: no such model, or not its number of parameters.
    """

    def __init__(self, model: str, parameters: Sequence[float], size: tuple[int, int]):
        import pycolmap

        self.model, self.size = model, size
        self._camera = pycolmap.Camera(model=model, width=size[0], height=size[1], params=list(map(float, parameters)))
        K = self._camera.calibration_matrix()
        self._focal, self._middle = np.diag(K)[:2], K[:2, 2] - 0.5

    @classmethod
    def opencv(cls, K: np.ndarray, coefficients: Sequence[float], size: tuple[int, int]) -> Lens:
        """OpenCV's model by its own K, pixel centres at whole numbers, and k1 k2 p1 p2 [k3 [k4 k5 k6]]."""
        more = [*coefficients[4:], 0.0, 0.0, 0.0, 0.0][:4]
        flat = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *coefficients[:4]]
        return cls("FULL_OPENCV", [*flat, *more], size) if any(more) else cls("OPENCV", flat, size)

    def scaled(self, size: tuple[int, int]) -> Lens:
        """The same lens before an image of another size."""
        import pycolmap

        camera = pycolmap.Camera(self._camera.todict())
        camera.rescale(*size)
        return Lens(self.model, camera.params.tolist(), size)

    def straight(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 2) of the straight image where points of the bent one come to lie; nan where none is."""
        flat = np.asarray(self._camera.cam_from_img(np.asarray(points, float) + 0.5))
        return flat * self._focal + self._middle

    def bent(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 2) of the bent image where points of the straight one come from; nan where none is."""
        flat = (np.asarray(points, float) - self._middle) / self._focal
        return np.asarray(self._camera.img_from_cam(np.column_stack([flat, np.ones(len(flat))]))) - 0.5

    @cached_property
    def _source(self) -> tuple[np.ndarray, np.ndarray]:
        """For each pixel of the straight image its place in the bent one, (2, H, W) row and column, and if it has one."""
        width, height = self.size
        rows, columns = np.divmod(np.arange(width * height), width)
        grid = np.column_stack([columns, rows])
        place = self.bent(grid).reshape(height, width, 2)
        rate = np.empty((2, height, width, 2))
        rate[0], rate[1] = np.gradient(place, axis=0), np.gradient(place, axis=1)
        # beyond where the model turns back on itself it shows what lies elsewhere
        whole = np.linalg.det(np.moveaxis(rate[::-1], 0, -1)) > 0
        inside = ((place >= -0.5) & (place <= [width - 0.5, height - 0.5])).all(axis=-1)
        return np.nan_to_num(np.moveaxis(place, -1, 0)[::-1], nan=-1.0), whole & inside

    @property
    def covered(self) -> np.ndarray:
        """Pixels of the straight image that the bent one shows, shape (H, W), bool."""
        return self._source[1]

    def image(self, bent: np.ndarray) -> np.ndarray:
        """The straight image, shape (H, W) or (H, W, 3), float32, linear between pixels; not `covered`: as beside."""
        layers = np.moveaxis(np.atleast_3d(bent), -1, 0)
        out = [ndimage.map_coordinates(layer, self._source[0], order=1, mode="nearest") for layer in layers]
        return np.ascontiguousarray(np.stack(out, axis=-1).reshape(bent.shape), dtype=np.float32)

    def mask(self, bent: np.ndarray) -> np.ndarray:
        """The straight mask, shape (H, W), bool; True also where nothing is `covered`."""
        moved = ndimage.map_coordinates(bent.astype(np.uint8), self._source[0], order=0, mode="nearest") > 0
        return moved | ~self.covered
