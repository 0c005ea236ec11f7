"""Several images of one near-axisymmetric solid with known truth: rings of cameras and pairs of eyes.

`python -m symseek.scenes.views` writes the images, the scene file and the truth of the scene `squash_ring` anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..sim.camera import Camera
from . import shapes
from .synthetic import KINDS, _look, render, turn_z, volume

LENGTH = 100.0
"""Of the axis, in world units."""
FILLED = 0.68
"""Share of the image's side that the solid takes at most in any view."""
DISTANCE = 5.0
"""Of perspective cameras from its middle, in lengths of the axis."""
UNEVEN = 0.25
"""How far cameras stand from even places on the ring, in steps from one to the next."""

RING_SEED = 12
RING_HEAD = """# Eight small photographs round a squash, by cameras that are known, and its rough axis in two of them.
# Written by `python -m symseek.scenes.views`; truth.npz holds the true mesh and axis.
units = "mm"
"""


@dataclass(frozen=True)
class Views:
    """Images of one solid and everything that is true of it."""

    images: list[np.ndarray]
    """float32 in [0, 1], shape (H, W) each, or (H, W, 3) in colour."""
    coverages: list[np.ndarray]
    """share of each pixel that the solid covers, float32, shape (H, W) each."""
    cameras: list[Camera]
    clicks: list[np.ndarray]
    """five rough points (column, row) along the projected axis in each view, shape (5, 2)."""
    vertices: np.ndarray
    """true mesh, watertight, shape (V, 3)."""
    faces: np.ndarray
    """shape (F, 3), normals outward."""
    spine: np.ndarray
    """true axis, shape (n, 3), equal steps of arc length."""
    volume: float
    kind: str
    seed: int
    length: float = LENGTH
    """of the axis."""


def ring(seed: int, count: int, perspective: bool = False, kind: str | None = None, **look: Any) -> Views:
    """A solid that stands, tilted a little, in the middle of a ring of cameras a little above it, unevenly spaced.

    Args:
        seed: fixes solid, pose, light, cameras and clicks, whatever else is varied.
        count: of cameras.
        perspective: or orthographic.
        kind: by default `KINDS[seed % 11]`.
        look: see `_seen`.
    """
    solid, pose, place = (np.random.default_rng([seed, k]) for k in range(3))
    kind, mesh, axis = _solid(seed, kind, solid, look.pop("out_of_round", 0.0))
    tilt, about, spin = np.radians(pose.uniform(0, 20)), *pose.uniform(0, 2 * np.pi, 2)
    upright = turn_z(np.pi / 2) @ turn_z(-_heading(axis))
    turn = turn_y(about) @ turn_z(tilt) @ turn_y(spin) @ upright
    first, height = place.uniform(0, 2 * np.pi), np.radians(place.uniform(5, 25))
    steps = np.arange(count) + place.uniform(-UNEVEN, UNEVEN, count)
    heights = height + np.radians(place.uniform(-3, 3, count))
    eyes = [turn_x(up) @ turn_y(first + 2 * np.pi * k / count) for k, up in zip(steps, heights, strict=True)]
    return _seen(seed, kind, mesh, axis, turn, lambda size, scale: looking_in(eyes, size, scale, perspective), **look)


def pair(seed: int, perspective: bool = False, kind: str | None = None, **look: Any) -> Views:
    """A solid before a pair of eyes, its axis up to 35 degrees out of the image plane.

    Args:
        seed: fixes solid, pose, light, eyes and clicks, whatever else is varied.
        perspective: two cameras that converge; otherwise the paper's (15), alpha from 0.1 to 0.25 either way.
        kind: by default `KINDS[seed % 11]`.
        look: see `_seen`.
    """
    solid, pose, place = (np.random.default_rng([seed, k]) for k in range(3))
    kind, mesh, axis = _solid(seed, kind, solid, look.pop("out_of_round", 0.0))
    tilt, about, spin = np.radians(pose.uniform(-35, 35)), *pose.uniform(0, 2 * np.pi, 2)
    lying = turn_z(-_heading(axis))
    turn = turn_z(about) @ turn_y(tilt) @ turn_x(spin) @ lying
    alpha = place.uniform(0.1, 0.25)

    def eyes(size: int, scale: float) -> list[Camera]:
        if perspective:
            return looking_in([turn_y(s * np.arctan(alpha)) for s in (1, -1)], size, scale, True)
        out = [Camera.stereo(a, 1 / scale) for a in (alpha, -alpha)]
        for camera in out:
            camera.matrix[:2, 3] = (size - 1) / 2
        return out

    return _seen(seed, kind, mesh, axis, turn, eyes, **look)


def _solid(
    seed: int, kind: str | None, rng: np.random.Generator, out_of_round: float
) -> tuple[str, tuple[np.ndarray, np.ndarray], np.ndarray]:
    kind = KINDS[seed % len(KINDS)] if kind is None else kind
    sweep = shapes.sweep(kind, rng)
    mesh = shapes.mesh(sweep, out_of_round=out_of_round, rng=rng)
    return kind, mesh, np.column_stack([sweep.axis[::20], np.zeros(len(sweep.axis[::20]))])


def _seen(
    seed: int,
    kind: str,
    mesh: tuple[np.ndarray, np.ndarray],
    axis: np.ndarray,
    turn: np.ndarray,
    eyes,
    size: int = 512,
    noise: float = 0.01,
    ambient: float = 0.6,
    click_error: float = 4.0,
    colour: bool = False,
) -> Views:
    """Images of `size` by `size` pixels; `click_error` [px] at 512, more in larger images."""
    light_rng, click_rng, noise_rng = (np.random.default_rng([seed, k]) for k in range(3, 6))
    vertices, faces = mesh
    middle = (vertices.max(0) + vertices.min(0)) / 2
    vertices, axis = (LENGTH * (p - middle) @ turn.T for p in (vertices, axis))
    cameras = eyes(size, 1.0)
    wide = max(np.ptp(c.project(vertices), axis=0).max() for c in cameras)
    cameras = eyes(size, FILLED * size / wide)
    light, paint, background = _look(light_rng, size, "bright", colour)
    images, coverages, clicks = [], [], []
    for camera in cameras:
        shade, cover = render(vertices, faces, (size, size), light, ambient, camera=camera)
        image = (1 - cover[..., None]) * background + (cover * shade)[..., None] * paint
        image = np.clip(image + noise * noise_rng.standard_normal(image.shape), 0, 1).astype(np.float32)
        images.append(image if colour else image[..., 0])
        coverages.append(cover)
        at = np.linspace(0.12, 0.88, 5) * (len(axis) - 1)
        exact = camera.project(np.stack([np.interp(at, np.arange(len(axis)), c) for c in axis.T], 1))
        clicks.append(exact + click_error * size / 512 * click_rng.standard_normal(exact.shape))
    return Views(images, coverages, cameras, clicks, vertices, faces, axis, volume(vertices, faces), kind, seed)


def looking_in(eyes: Sequence[np.ndarray], size: int, scale: float, perspective: bool) -> list[Camera]:
    """Cameras that look at the origin, by world-to-camera rotations (3, 3); `scale` in px per world unit there."""
    middle, out = (size - 1) / 2, []
    for rotation in eyes:
        if perspective:
            far = DISTANCE * LENGTH
            K = np.array([[scale * far, 0, middle], [0, scale * far, middle], [0, 0, 1]])
            out.append(Camera.perspective(K, rotation, np.array([0, 0, far])))
        else:
            rows = np.column_stack([scale * rotation[:2], [middle, middle]])
            out.append(Camera(np.vstack([rows, [0, 0, 0, 1]])))
    return out


def _heading(axis: np.ndarray) -> float:
    chord = axis[-1] - axis[0]
    return float(np.arctan2(chord[1], chord[0]))


def turn_x(angle: float) -> np.ndarray:
    """Rotation (3, 3) about X."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_y(angle: float) -> np.ndarray:
    """Rotation (3, 3) about Y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def write_ring(folder: Path) -> None:
    """Write view1.jpg to view8.jpg, scene.toml and truth.npz: a crook-necked squash, eight small photographs round it."""
    folder.mkdir(parents=True, exist_ok=True)
    made = ring(RING_SEED, 8, perspective=True, kind="squash", size=256, colour=True)
    text = [RING_HEAD]
    for k, (image, camera) in enumerate(zip(made.images, made.cameras, strict=True), 1):
        picture = Image.fromarray(np.uint8(np.round(255 * image)))
        picture.save(folder / f"view{k}.jpg", quality=92, subsampling=0)
        rows = ",\n     ".join(str([float(f"{x:.9g}") for x in row]) for row in camera.matrix)
        text.append(f'[[view]]\nname = "view{k}"\nimage = "view{k}.jpg"\nprojection = "matrix"\nP = [{rows}]\n')
    axes = {f"view{k}": np.round(made.clicks[k - 1]).astype(int).tolist() for k in (1, 3)}
    text.append("[[object]]")
    text += [f"spines.{name} = {points}" for name, points in axes.items()]
    (folder / "scene.toml").write_text("\n".join(text) + "\n", encoding="utf-8")
    np.savez_compressed(
        folder / "truth.npz",
        vertices=made.vertices.astype(np.float32),
        faces=made.faces.astype(np.uint16),
        spine=made.spine,
        length=made.length,
        volume=made.volume,
    )


if __name__ == "__main__":
    write_ring(Path(__file__).parent / "squash_ring")
