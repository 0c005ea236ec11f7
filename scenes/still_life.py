"""Pictures of one solid behind another, with known truth: what each covers, what of it is seen, and which lies in front.

`python -m symseek.scenes.still_life` writes the image and the truth of the scene `pear_potato` anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from ..sim.camera import Camera
from . import raster, shapes
from .synthetic import MARGIN, Sample, light_from, mean_radius, render, rough_clicks, turn_z, volume

FRONT = ("egg", "pear", "peanut", "squash", "bent")
HIDDEN = 0.05, 0.35
"""Share of the back solid's silhouette that the front one covers."""
SHIPPED = 10
"""Seed of the scene `pear_potato`."""
COARSE = 128
"""Side of the picture in which solids are placed [px]."""


@dataclass(frozen=True)
class StillLife:
    """A picture of a solid behind another; world units are pixels, both axes have mean Z 0 in their own truth."""

    image: np.ndarray
    """float32 in [0, 1], shape (H, W, 3)."""
    lone: np.ndarray
    """the same picture without the back solid."""
    front: Sample
    back: Sample
    """`coverage` is of the whole silhouette, hidden or not."""
    depth: float
    """of the back solid's axis behind the front one's, so that they do not touch [px]."""
    hidden: float
    """share of the back solid's silhouette that the front one covers."""

    @property
    def covered(self) -> np.ndarray:
        """Share of each pixel in which the front solid hides the back one, shape (H, W)."""
        return np.minimum(self.front.coverage, self.back.coverage)


def make(
    seed: int,
    size: int = 512,
    noise: float = 0.01,
    hidden: float | None = None,
    click_error: float = 4.0,
    kinds: tuple[str, str] | None = None,
) -> StillLife:
    """Two random solids: by default one of the kinds FRONT before one of any kind.

    The seed fixes shapes, places, colours, light and clicks; clicks run along the whole axis of each, hidden or not, with
    a standard deviation of `click_error` [px at size 512] in each coordinate. Solids may be lighter or darker than what
    is behind them, and of like or unlike colours.
    """
    rng = np.random.default_rng([seed, 7])
    share = rng.uniform(*HIDDEN) if hidden is None else hidden
    drawn = str(rng.choice(FRONT)), str(rng.choice(shapes.KINDS))
    kinds = kinds or drawn
    solids = [shapes.sweep(kind, rng) for kind in kinds]
    laid = _placed(solids, share, rng)
    light = light_from(rng)
    paints, ground = _paints(rng)
    ambient = rng.uniform(0.35, 0.7)
    image = lone = np.broadcast_to(ground, (size, size, 3))
    samples: list[Sample] = []
    for solid, kind, (turn, scale, middle), paint in reversed(list(zip(solids, kinds, laid, paints, strict=True))):
        vertices, faces = shapes.mesh(solid)
        axis = np.column_stack([solid.axis[::10], np.zeros(len(solid.axis[::10]))])
        vertices, axis = ((scale * p @ turn.T + [*middle, 0]) * size - [0.5, 0.5, 0] for p in (vertices, axis))
        shade, cover = render(vertices, faces, (size, size), light, ambient)
        alpha = cover[..., None]
        # the front solid comes last
        image, lone = ((1 - alpha) * under + alpha * shade[..., None] * paint for under in (image, ground))
        samples.append(
            Sample(
                image=image,
                coverage=cover,
                vertices=vertices,
                faces=faces,
                spine=axis,
                radius=scale * size * mean_radius(solid, len(axis)),
                clicks=rough_clicks(axis, click_error * size / 512, rng),
                length=scale * size,
                volume=volume(vertices, faces),
                camera=Camera.orthographic(),
                kind=kind,
                seed=seed,
            )
        )
    grain = noise * rng.standard_normal(image.shape)
    image, lone = (np.clip(picture + grain, 0, 1).astype(np.float32) for picture in (image, lone))
    back, front = (replace(sample, image=image) for sample in samples)
    both = np.minimum(front.coverage, back.coverage).sum() / back.coverage.sum()
    return StillLife(image, lone, front, back, 1.1 * float(front.radius.max() + back.radius.max()), float(both))


def _paints(rng: np.random.Generator) -> tuple[list[np.ndarray], np.ndarray]:
    """Colours of the two solids, and of what is behind them, which differs from both."""
    bright = rng.uniform() < 0.65
    ground = rng.uniform(0.03, 0.2) if bright else rng.uniform(0.75, 0.95)
    paints = []
    for _ in range(2):
        grey = rng.uniform(0.55, 0.95) if bright else rng.uniform(0.15, 0.5)
        hue = 1 - rng.uniform(0, 0.6) * rng.uniform(0, 1, 3)
        paints.append(grey * hue / hue.max())
    return paints, ground * (1 - 0.2 * rng.uniform(0, 1, 3))


def _placed(
    solids: list[shapes.Sweep], share: float, rng: np.random.Generator
) -> list[tuple[np.ndarray, float, np.ndarray]]:
    """Turn, scale and middle of each solid, in sides of the picture, so that the first covers a share of the second."""
    for _ in range(200):
        turns = [turn_z(rng.uniform(0, 2 * np.pi)) for _ in solids]
        sizes = rng.uniform(0.32, 0.5), rng.uniform(0.42, 0.62)
        outlines, extents = [], []
        for solid, turn, size in zip(solids, turns, sizes, strict=True):
            vertices, faces = shapes.mesh(solid, around=48, along=64)
            seen = (vertices @ turn.T)[:, :2]
            scale = size / np.ptp(seen, axis=0).max()
            centre = scale * (seen.max(0) + seen.min(0)) / 2
            outlines.append((scale * seen - centre, faces, scale, centre))
            extents.append(scale * np.ptp(seen, axis=0) / 2)
        direction = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(direction), np.sin(direction)])
        gap = _gap(outlines, way, share)
        low, high = np.minimum(way * gap - extents[0], -extents[1]), np.maximum(way * gap + extents[0], extents[1])
        free = 1 - 2 * MARGIN - (high - low)
        if gap > 0 and np.all(free > 0):
            corner = MARGIN + rng.uniform(0, 1, 2) * free - low
            places = corner + way * gap, corner
            return [
                (turn, scale, place - centre)
                for turn, (_, _, scale, centre), place in zip(turns, outlines, places, strict=True)
            ]
    raise ValueError("no place was found for these solids")


def _gap(outlines: list, way: np.ndarray, share: float) -> float:
    """How far apart along a way the middles lie when the first covers that share of the second; 0 where it never does."""
    shape = COARSE, COARSE

    def cover(k: int, shift: np.ndarray) -> np.ndarray:
        points, faces = outlines[k][:2]
        return raster.coverage((points + shift + 0.5) * COARSE, faces, shape, 2)

    back = cover(1, np.zeros(2))
    near, far = 0.0, 0.5
    if np.minimum(back, cover(0, way * near)).sum() < share * back.sum():
        return 0.0
    for _ in range(9):
        middle = (near + far) / 2
        more = np.minimum(back, cover(0, way * middle)).sum() > share * back.sum()
        near, far = (middle, far) if more else (near, middle)
    return (near + far) / 2


def write(folder: Path) -> None:
    """Write pear_potato.jpg and truth.npz: of both solids axis, radius, length, volume and whole coverage (of 255)."""
    life = make(SHIPPED, kinds=("egg", "pear"))
    folder.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(np.uint8(np.round(255 * life.image)))
    picture.save(folder / "pear_potato.jpg", quality=92, subsampling=0)
    arrays = {}
    for name, sample in (("potato", life.front), ("pear", life.back)):
        arrays[f"{name}_coverage"] = np.uint8(np.round(255 * sample.coverage))
        for key in ("spine", "radius", "length", "volume"):
            arrays[f"{name}_{key}"] = getattr(sample, key)
    np.savez_compressed(folder / "truth.npz", **arrays)


if __name__ == "__main__":
    write(Path(__file__).parent / "pear_potato")
