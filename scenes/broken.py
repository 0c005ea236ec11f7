"""Scenes of solids with a discontinuity: a carrot snapped in two, and a spinning top with a sharp edge.

`python -m symseek.scenes.broken` writes the images and truths of the scenes `crack` and `crease` anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from . import shapes
from .synthetic import render, table_top, turn_z, volume

SIZE = (480, 640)
LIGHT = np.array([-0.5, -0.62, -1.0])

SNAPPABLE = ("carrot", "bent", "bottle", "banana", "pear", "worm", "squash", "peanut")
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


@dataclass(frozen=True)
class Snapped:
    """An image of a solid in two parts, and what a user would say of it."""

    image: np.ndarray
    """float32 in [0, 1], shape (size, size)."""
    coverage: np.ndarray
    """share of each pixel that the parts cover, float32, shape (size, size)."""
    clicks: np.ndarray
    """six rough points (column, row), three along each part, shape (6, 2)."""
    place: np.ndarray
    """where it snapped, roughly (column, row)."""
    gap: float
    """between the parts [px]."""
    kind: str


def snapped(seed: int, size: int = 512) -> Snapped:
    """A random solid snapped across its middle part: a gap up to 16 px of 512, a step aside, a knee up to 25 degrees."""
    rng = np.random.default_rng([seed, 77])
    kind = SNAPPABLE[seed % len(SNAPPABLE)]
    solid, at, length = shapes.sweep(kind, rng), rng.uniform(0.3, 0.7), rng.uniform(260, 360) * size / 512
    u = np.linspace(0, 1, len(solid.axis))
    radius = np.interp(at, solid.station, solid.radius) * length
    gap, aside = rng.uniform(0, 16) * size / 512, rng.uniform(-0.5, 0.5) * radius
    knee, heading = np.radians(rng.uniform(-25, 25)), rng.uniform(0, 2 * np.pi)
    cut = np.append([np.interp(at, u, c) for c in solid.axis.T], 0)
    along = np.append([np.interp(at, u, c) for c in np.gradient(solid.axis, u, axis=0).T], 0)
    along /= np.linalg.norm(along)
    across = np.array([-along[1], along[0], 0])

    def placed(points: np.ndarray, side: int) -> np.ndarray:
        turned = length * (points - cut) @ turn_z(side * knee / 2).T
        apart = gap / 2 + abs(np.tan(knee / 2)) * radius  # the inner corners of the faces do not meet
        return (turned + side * (apart * along + aside / 2 * across)) @ turn_z(heading).T

    (first, faces), (second, other) = halves(solid, at)
    vertices, faces = joined((placed(first, -1), faces), (placed(second, 1), other))
    middle = np.append(size / 2 - (vertices[:, :2].max(0) + vertices[:, :2].min(0)) / 2, 0)
    off, around = np.radians(rng.uniform(10, 45)), rng.uniform(0, 2 * np.pi)
    light = np.array([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), -np.cos(off)])
    shade, cover = render(vertices + middle, faces, (size, size), light)
    image = 0.06 * (1 - cover) + 0.85 * shade * cover + 0.01 * rng.standard_normal((size, size))

    def seen(side: int, *stations: float) -> np.ndarray:
        axis = np.column_stack([*(np.interp(stations, u, c) for c in solid.axis.T), np.zeros(len(stations))])
        return (placed(axis, side) + middle)[:, :2]

    clicks = np.concatenate([seen(-1, 0.12, at * 0.55, at * 0.93), seen(1, 1 - (1 - at) * 0.93, 1 - (1 - at) * 0.55, 0.88)])
    clicks += 3 * size / 512 * rng.standard_normal(clicks.shape)
    place = (seen(-1, at)[0] + seen(1, at)[0]) / 2 + 2 * size / 512 * rng.standard_normal(2)
    return Snapped(np.clip(image, 0, 1).astype(np.float32), cover, clicks, place, gap, kind)


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
