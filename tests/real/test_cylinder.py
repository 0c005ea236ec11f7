"""A cylinder of 57.0 mm that two calibrated cameras see, from the folder in SYMSEEK_DATA: its radius by its outlines."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.io import loadmat

import symseek

FOLDER = Path(os.environ.get("SYMSEEK_DATA", "/nowhere")) / "cylinder_stereo_metrology" / "calibrationObjectImages"
RADIUS = 57.0
"""In mm, about the world's Z axis; its dots lie at heights of 10 to 238."""
SMALLER = 4
"""Images are reduced so much."""

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="SYMSEEK_DATA does not name the folder with cylinder_stereo_metrology"
)


def _view(camera: int) -> dict:
    """Image and camera; DLT parameters count pixels from 1, and our centres lie at whole numbers from 0."""
    found = loadmat(FOLDER / f"DLTstruct_cam_{camera}.mat", squeeze_me=True)["DLTstructCam"]
    shift = 0.5 * (1 / SMALLER - 1) - 1 / SMALLER
    fewer = np.array([[1 / SMALLER, 0, shift], [0, 1 / SMALLER, shift], [0, 0, 1]])
    image = np.asarray(Image.open(FOLDER / f"{camera}.jpg").reduce(SMALLER), np.float32) / 255
    matrix = np.append(found["DLTparams"].item(), 1.0).reshape(3, 4)
    return {"name": str(camera), "image": image, "projection": "matrix", "P": fewer @ matrix}


def test_radius(record_property):
    """Bright strips cross the background right behind the outlines; lens distortion is left as it is."""
    spine = [[3, -3, 15], [-3, 2, 80], [2, 3, 150], [-2, -3, 225]]
    found = symseek.reconstruct(views=[_view(201), _view(202)], spine=spine, units="mm").objects[0]
    body = (found.spine[0][:, 2] > 30) & (found.spine[0][:, 2] < 210)
    rings = found.tube[0][:, body]
    radius = np.linalg.norm(rings - rings.mean(axis=0), axis=2).mean(axis=0)
    record_property("radius", radius.mean())
    assert abs(radius.mean() - RADIUS) < 1.0 and abs(np.median(radius) - RADIUS) < 0.5, radius.round(2)
    # and where it stands: dots fix the cameras' world, outlines alone our surface
    away = np.linalg.norm(found.vertices[:, :2], axis=1)[(found.vertices[:, 2] > 30) & (found.vertices[:, 2] < 210)] - RADIUS
    assert abs(away.mean()) < 1.0 and away.std() < 2.0
    assert found.trusted, found.warnings
