"""Projection Pi of (11): 3 x 4 cameras, world frame X right, Y down, Z away from the viewer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A 3 x 4 matrix from homogeneous world points to homogeneous image points (column, row, 1).

    Affine where the last row is (0, 0, 0, 1). Pixel centres lie at whole numbers.
    """

    matrix: np.ndarray
    """shape (3, 4), float64."""

    @classmethod
    def orthographic(cls, scale: float = 1.0) -> Camera:
        """(xi, eta) = (X, Y) / scale, with `scale` in world units per pixel (section 4.1)."""
        return cls(np.array([[1 / scale, 0, 0, 0], [0, 1 / scale, 0, 0], [0, 0, 0, 1.0]]))

    @classmethod
    def stereo(cls, alpha: float, scale: float = 1.0) -> Camera:
        """The paper's (15): (xi, eta) = (X + alpha Z, Y) / scale, with its own signed alpha for each eye."""
        return cls(np.array([[1 / scale, 0, alpha / scale, 0], [0, 1 / scale, 0, 0], [0, 0, 0, 1.0]]))

    @classmethod
    def perspective(cls, K: np.ndarray, R: np.ndarray, t: np.ndarray) -> Camera:
        """K (3, 3), R (3, 3), t (3,), world to camera."""
        return cls(np.asarray(K, float) @ np.column_stack([np.asarray(R, float), np.asarray(t, float)]))

    @cached_property
    def affine(self) -> bool:
        """Whether all lines of sight are parallel."""
        return bool(np.allclose(self.matrix[2, :3], 0.0))

    def project(self, points: np.ndarray) -> np.ndarray:
        """World points, shape (..., 3), to image points (column, row), shape (..., 2)."""
        h = points @ self.matrix[:, :3].T + self.matrix[:, 3]
        return h[..., :2] / h[..., 2:]

    def in_units(self, unit: float, origin: np.ndarray) -> Camera:
        """The camera that takes points in a unit of length about an origin, shape (3,), in the world."""
        change = np.eye(4)
        change[:3, :3] *= unit
        change[:3, 3] = origin
        return Camera(self.matrix @ change)

    def sight(self, points: np.ndarray) -> np.ndarray:
        """Unit vectors i of (12) along the line of sight to each world point, away from the viewer, (..., 3)."""
        if self.affine:
            return np.broadcast_to(self._ahead, points.shape)
        d = points - self._centre
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Depth of world points (..., 3) as `initial.lift` takes it: along the view's axis, homogeneous if perspective."""
        return self.distance(points) if self.affine else points @ self.matrix[2, :3] + self.matrix[2, 3]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Depth of world points (..., 3): along the axis from the origin (affine), from the focal point otherwise."""
        if self.affine:
            return points @ self.sight(np.zeros(3))
        return np.linalg.norm(points - self._centre, axis=-1)

    @cached_property
    def _ahead(self) -> np.ndarray:
        """Direction of all lines of sight, shape (3,), of an affine camera."""
        d = np.cross(self.matrix[0, :3], self.matrix[1, :3])
        return d / np.linalg.norm(d)

    @cached_property
    def _centre(self) -> np.ndarray:
        """Where all lines of sight meet, shape (3,), of another."""
        return -np.linalg.solve(self.matrix[:, :3], self.matrix[:, 3])
