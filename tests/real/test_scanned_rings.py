"""Scanned fruit from the folder in SYMSEEK_DATA, rendered from eight sides: volumes against those of the scans."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

import symseek
from benchmarks.truth import volume
from symseek.scenes.synthetic import render
from symseek.scenes.views import looking_in, turn_x, turn_y

FOLDER = Path(os.environ.get("SYMSEEK_DATA", "/nowhere")) / "ycb_meshes" / "derived"
SIZE, LIGHT = 400, np.array([-0.5, -0.6, -1.0])

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="SYMSEEK_DATA does not name the folder with ycb_meshes")


def _ring(name: str) -> tuple[np.ndarray, np.ndarray, list[dict]]:
    """Vertices [mm], long axis along Y, and faces; views of it on a dark ground."""
    mesh = trimesh.load_mesh(FOLDER / f"{name}_geom.ply")
    points = 1000 * (np.asarray(mesh.vertices) - mesh.bounding_box.centroid)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][[1, 0, 2]]
    axes *= np.linalg.det(axes)
    points = points @ axes.T
    scale = 0.7 * SIZE / np.ptp(points[:, 1])
    eyes = [turn_x(0.2) @ turn_y(2 * np.pi * (k + 0.1 * (k % 3)) / 8) for k in range(8)]
    views = []
    for k, camera in enumerate(looking_in(eyes, SIZE, scale, True)):
        shade, cover = render(points, np.asarray(mesh.faces), (SIZE, SIZE), LIGHT, camera=camera)
        image = 0.1 + (0.8 * shade - 0.1) * cover
        views.append({"name": f"view{k}", "image": image, "projection": "matrix", "P": camera.matrix})
    return points, np.asarray(mesh.faces), views


@pytest.mark.parametrize(("name", "bar"), [("016_pear", 0.02), ("011_banana", 0.03)])
def test_volume(name, bar, record_property):
    points, faces, views = _ring(name)
    heights = np.quantile(points[:, 1], [0.05, 0.25, 0.5, 0.75, 0.95])
    near = [points[np.abs(points[:, 1] - h) < 5.0] for h in heights]
    rng = np.random.default_rng(3)
    spine = np.array([(p.min(axis=0) + p.max(axis=0)) / 2 for p in near]) + rng.normal(0, 2.0, (5, 3))  # mm
    result = symseek.reconstruct(views=views, spine=spine, units="mm")
    found = result.objects[0]
    error = found.measures["volume"] / volume(points, faces) - 1
    record_property("volume", error)
    assert abs(error) < bar, f"volume {error:+.1%}; {found.warnings}"
