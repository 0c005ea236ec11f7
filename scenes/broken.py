"""Scenes of solids with a discontinuity: a carrot snapped in two, and a spinning top with a sharp edge.

`python -m symseek.scenes.broken` writes the images and truths of the scenes `crack` and `crease` anew.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from . import shapes
from .synthetic import render, table_top, turn_z, volume

SIZE = (480, 640)
LIGHT = np.array([-0.5, -0.62, -1.0])

CARROT_SEED, CARROT_LENGTH, SNAPPED_AT = 21, 480.0, 0.45
TOP_LENGTH, EDGE_AT = 480.0, 0.62

Mesh = tuple[np.ndarray, np.ndarray]


def halves(solid: shapes.Sweep, at: float, around: int = 96, along: int = 100) -> tuple[Mesh, Mesh]:
    """Watertight meshes of both parts of a solid cut flat across its axis at station `at`."""
    station, radius = shapes.resample(solid, along)
    u, cut = np.linspace(0, 1, len(solid.axis)), np.interp(at, station, radius)
    slope = np.gradient(solid.axis, u, axis=0, edge_order=2)
    face, worn = np.full(3, at), cut * np.array([1.0, 0.97, 0.0])
    before, after = station < at, station > at
    parts = []
    for s, r in (
        (np.append(station[before], face), np.append(radius[before], worn)),
        (np.append(face, station[after]), np.append(worn[::-1], radius[after])),
    ):
        centre, tangent = (np.stack([np.interp(s, u, c) for c in of.T], 1) for of in (solid.axis, slope))
        parts.append(shapes.tube(centre, tangent, np.repeat(r[:, None], around, axis=1)))
    return parts[0], parts[1]


def top(at: float, widest: float, ends: tuple[float, float], bend: float) -> shapes.Sweep:
    """Two cones with round tips, base to base at station `at`, on a slightly bent axis [rad]; lengths of the axis."""
    fine = np.union1d((1 - np.cos(np.linspace(0, np.pi, 2001))) / 2, [at])
    radius = np.interp(fine, [0, at, 1], [ends[0], widest, ends[1]])
    station, radius = shapes.close(fine, radius, (shapes.Round(1.0), shapes.Round(1.0)))
    u = np.linspace(0, 1, 2001)
    return shapes.Sweep(station, radius, shapes.line(u, np.full_like(u, bend)))


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return np.concatenate([v for v, _ in meshes]), np.concatenate([f + s for (_, f), s in zip(meshes, starts, strict=False)])


def snapped_carrot() -> Mesh:
    """A carrot in two parts, some pixels apart and at an angle, [px]."""
    solid = shapes.sweep("carrot", np.random.default_rng(CARROT_SEED))
    u = np.linspace(0, 1, len(solid.axis))
    cut = np.append([np.interp(SNAPPED_AT, u, c) for c in solid.axis.T], 0)
    parts = []
    for (vertices, faces), angle, place in zip(
        halves(solid, SNAPPED_AT), (0.41, 0.03), ([291.0, 239, 0], [309.0, 245, 0]), strict=True
    ):
        parts.append((CARROT_LENGTH * (vertices - cut) @ turn_z(angle).T + place, faces))
    return joined(*parts)


def spinning_top() -> Mesh:
    """Two cones that meet in a sharp edge, in the middle of the image, [px]."""
    vertices, faces = shapes.mesh(top(EDGE_AT, 0.2, (0.05, 0.03), np.radians(20.0)), around=96, along=128)
    vertices = TOP_LENGTH * vertices @ turn_z(0.35).T
    low, high = vertices[:, :2].min(0), vertices[:, :2].max(0)
    middle = (np.array(SIZE[::-1]) - low - high) / 2
    return vertices + np.append(middle, 0), faces


def write(folder: Path, mesh: Mesh, paint: tuple[float, float, float]) -> None:
    """Write NAME.jpg, named as the folder is, of a solid on a table, and truth.npz: its mesh and volume."""
    vertices, faces = mesh
    shade, cover = render(vertices, faces, SIZE, LIGHT, ambient=0.42, gloss=0.18)
    image = table_top(cover) * (1 - cover[..., None]) + np.array(paint) * (shade * cover)[..., None]
    image += 0.01 * np.random.default_rng(5).standard_normal(image.shape)
    folder.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(np.uint8(np.round(255 * np.clip(image, 0, 1))))
    picture.save(folder / f"{folder.name}.jpg", quality=92, subsampling=0)
    truth = {"vertices": vertices.astype(np.float32), "faces": faces.astype(np.uint16)}
    np.savez_compressed(folder / "truth.npz", **truth, volume=volume(vertices, faces))


if __name__ == "__main__":
    here = Path(__file__).parent
    write(here / "crack", snapped_carrot(), (0.95, 0.45, 0.12))
    write(here / "crease", spinning_top(), (0.8, 0.25, 0.3))
