"""Light on a mesh, computed at its vertices, and the backdrop behind it.

A rasteriser that only interpolates colours is ten times faster in software than one that lights every
pixel, and smooth, finely meshed shapes look the same. Directions are the viewer's: x right, y up, z toward
the viewer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_VIEWER = np.array([0.0, 0.0, 1.0])


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals, shape (V, 3): the area-weighted mean of the faces' normals around each vertex."""
    vertices = np.asarray(vertices, float)
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.column_stack([np.bincount(faces.ravel(), np.repeat(area[:, axis], 3), len(vertices)) for axis in range(3)])
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def _unit(*direction: float) -> np.ndarray:
    return np.asarray(direction) / np.linalg.norm(direction)


@dataclass(frozen=True)
class Lamp:
    """A distant light."""

    direction: np.ndarray
    """toward the lamp, unit length, shape (3,)."""
    colour: np.ndarray
    """linear RGB times strength, shape (3,)."""
    gloss: float
    """strength of its highlight."""


KEY = Lamp(_unit(-0.55, 0.62, 0.62), np.array([1.00, 0.95, 0.88]) * 0.98, 0.62)
FILL = Lamp(_unit(0.85, 0.05, 0.45), np.array([0.55, 0.74, 1.00]) * 0.24, 0.12)
RIM = np.array([0.78, 0.90, 1.00]) * 1.1  # light from behind, seen where the surface turns away
_RIM_SIDE = _unit(0.75, 0.45, -0.5)
_SKY, _GROUND = np.array([0.46, 0.50, 0.56]) * 0.5, np.array([0.36, 0.29, 0.24]) * 0.36


def lit(normals: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Colours, shape (V, 3), sRGB in [0, 1], of a satin surface with unit normals and sRGB 0 to 255, shape (V, 3) each."""
    normals = normals.astype(np.float32)
    albedo = (colours / 255.0) ** 2.2
    height = 0.5 + 0.5 * normals[:, 1:2]
    light = height * _SKY + (1 - height) * _GROUND
    shine = np.zeros((len(normals), 1))
    for lamp in (KEY, FILL):
        light = light + np.clip(normals @ lamp.direction, 0.0, 1.0)[:, None] * lamp.colour
        half = _unit(*(lamp.direction + _VIEWER))
        facing = np.clip(normals @ half, 0.0, 1.0)[:, None]
        shine = shine + lamp.gloss * (0.35 * facing**12 + 0.65 * facing**48) * 0.5
    graze = (1.0 - np.clip(normals[:, 2:3], 0.0, 1.0)) ** 3
    rim = graze * (0.25 + 0.75 * np.clip(normals @ _RIM_SIDE + 0.35, 0.0, 1.0)[:, None]) * RIM
    linear = albedo * light + shine * KEY.colour + rim * (0.35 + 0.65 * albedo)
    return _soft(linear) ** (1 / 2.2)


def _soft(linear: np.ndarray) -> np.ndarray:
    """Bend what is brighter than 0.7 so that highlights keep some colour."""
    knee = 0.7
    over = np.maximum(linear - knee, 0.0)
    return np.minimum(linear, knee) + (1 - knee) * (1 - np.exp(-over / (1 - knee)))


def backdrop(width: int, height: int) -> np.ndarray:
    """A studio wall, shape (height, width, 3), uint8: a soft glow, dithered against banding."""
    x = np.linspace(-1, 1, width)[None, :]
    y = np.linspace(-1, 1, height)[:, None]
    glow = np.exp(-(x**2 + (y + 0.15) ** 2) / 0.9)[..., None]
    wall = np.array([26.0, 30.0, 37.0]) + glow * np.array([50.0, 56.0, 64.0])
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, (height, width, 1))
    return np.clip(np.rint(wall + noise), 0, 255).astype(np.uint8)
