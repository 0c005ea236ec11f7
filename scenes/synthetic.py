"""Images of near-axisymmetric solids with known truth: mesh, axis, camera, coverage and rough clicks.

`python -m symseek.scenes.synthetic` writes the image and the truth of the scene `squash` anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, shift, uniform_filter
from skimage import measure

from ..sim.camera import Camera
from . import raster, shapes
from .shapes import KINDS

MARGIN = 0.06
"""Share of the image that stays free at each border."""

SQUASH_SEED, SQUASH_ANGLE, SQUASH_LENGTH = 8, 2.0, 520.0
TABLE_LIGHT = np.array([-0.5, -0.62, -1.0])
STILL_LIFE = {
    "pear": ("pear", 10, 1.72, 360.0, (205.0, 240.0), (0.72, 0.74, 0.22), 0.05),
    "potato": ("egg", 0, 0.5, 240.0, (460.0, 290.0), (0.74, 0.56, 0.36), 0.06),
}
"""Of figure 6's objects: kind, seed, angle, length [px], middle (column, row), colour, strength of blotches."""

__all__ = ["KINDS", "Sample", "make", "render"]


@dataclass(frozen=True)
class Sample:
    """An image of one solid and everything that is true of it. World units are pixels of this image."""

    image: np.ndarray
    """float32 in [0, 1], shape (H, W), or (H, W, 3) in colour."""
    coverage: np.ndarray
    """share of each pixel that the solid covers, float32, shape (H, W)."""
    vertices: np.ndarray
    """true mesh, watertight, [px], shape (V, 3), mean Z of the axis 0."""
    faces: np.ndarray
    """shape (F, 3), normals outward."""
    spine: np.ndarray
    """true axis [px], shape (n, 3), equal steps of arc length."""
    radius: np.ndarray
    """true mean radius at each point of `spine` [px], shape (n,)."""
    clicks: np.ndarray
    """five rough points (column, row) along the projected axis, shape (5, 2)."""
    length: float
    """of the axis [px]."""
    volume: float
    """of the mesh [px^3]."""
    camera: Camera
    kind: str
    seed: int

    @property
    def mask(self) -> np.ndarray:
        """Pixels at least half covered, bool, shape (H, W)."""
        return self.coverage >= 0.5


def make(
    seed: int,
    kind: str | None = None,
    size: int = 512,
    noise: float = 0.01,
    ambient: float = 0.6,
    contrast: Literal["bright", "dark"] = "bright",
    out_of_round: float = 0.0,
    tilt: float | None = None,
    click_error: float = 4.0,
    colour: bool = False,
) -> Sample:
    """A random solid of a kind (by default `KINDS[seed % 11]`), seen along Z and shaded by Lambert's law.

    The seed fixes the solid, its place, the light and the clicks, so that all else may be varied beside them;
    `size` [px] only scales them. `noise` is the standard deviation of the image's grey values, `ambient` the
    share of light that comes from everywhere, `out_of_round` the amplitude of the second and third harmonic
    of each section, `tilt` [degrees] the axis' angle with the image plane (by default 0, and 10 to 25 for the
    kind "tilted"), `click_error` [px at size 512] the standard deviation of each coordinate of the clicks.
    Raises ValueError for an unknown kind or contrast.
    """
    if contrast not in ("bright", "dark"):
        raise ValueError(f"contrast is {contrast!r}; it must be 'bright' or 'dark'")
    kind = KINDS[seed % len(KINDS)] if kind is None else kind
    streams = (np.random.default_rng([seed, k]) for k in range(5))
    shape_rng, place_rng, light_rng, click_rng, noise_rng = streams
    solid = shapes.sweep(kind, shape_rng)
    vertices, faces = shapes.mesh(solid, out_of_round=out_of_round, rng=shape_rng)
    if tilt is None:
        tilt = shape_rng.uniform(10, 25) if kind == "tilted" else 0.0
    axis = np.column_stack([solid.axis[::10], np.zeros(len(solid.axis[::10]))])
    scale, turn, shift = _placement(vertices, axis, tilt, place_rng)
    vertices = (scale * vertices @ turn.T + shift) * size
    vertices[:, :2] -= 0.5  # from lengths of the image to pixel centres at whole numbers
    spine = (scale * axis @ turn.T + shift) * size
    spine[:, :2] -= 0.5
    light, paint, background = _look(light_rng, size, contrast, colour)
    shade, cover = render(vertices, faces, (size, size), light, ambient)
    alpha = cover[..., None]
    image = (1 - alpha) * background + alpha * shade[..., None] * paint
    image = np.clip(image + noise * noise_rng.standard_normal(image.shape), 0, 1).astype(np.float32)
    return Sample(
        image=image if colour else image[..., 0],
        coverage=cover,
        vertices=vertices,
        faces=faces,
        spine=spine,
        radius=scale * size * mean_radius(solid, len(spine)),
        clicks=rough_clicks(spine, click_error * size / 512, click_rng),
        length=scale * size,
        volume=volume(vertices, faces),
        camera=Camera.orthographic(),
        kind=kind,
        seed=seed,
    )


def render(
    vertices: np.ndarray,
    faces: np.ndarray,
    shape: tuple[int, int],
    light: np.ndarray,
    ambient: float = 0.6,
    gloss: float = 0.0,
    samples: int = 2,
    camera: Camera | None = None,
    paint: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Lambert's shading of a smooth mesh, and how much of each pixel it covers, float32 (H, W); seen along Z by default.

    Shading is the mean over the part of the pixel that is covered, by samples x samples points a pixel;
    coverage counts 8 x 8. `light` (3,) points towards the light; `gloss` adds a highlight of that strength;
    `paint` (V,) multiplies what the solid sends back.
    """
    normals = vertex_normals(vertices, faces)
    points, depth = vertices[:, :2], vertices[:, 2]
    if camera is not None:
        points, depth = camera.project(vertices), camera.distance(vertices)
    front = faces[_turn(points, faces) < 0]
    seen = raster.visible(points, depth, front, shape, samples)
    row, column, face, weight = raster.barycentric(points, front, seen, samples)
    n = np.einsum("kc,kcd->kd", weight, normals[front[face]])
    n /= np.sqrt(np.einsum("kd,kd->k", n, n))[:, None]
    toward = light / np.linalg.norm(light)
    lit = ambient + (1 - ambient) * np.clip(n @ toward, 0, None)
    if paint is not None:
        lit *= np.einsum("kc,kc->k", weight, paint[front[face]])
    if gloss:
        halfway = toward + np.array([0.0, 0.0, -1.0])
        lit += gloss * np.clip(n @ (halfway / np.linalg.norm(halfway)), 0, None) ** 40
    pixel = row // samples * shape[1] + column // samples
    total = np.bincount(pixel, lit, shape[0] * shape[1]).reshape(shape)
    hits = np.bincount(pixel, minlength=shape[0] * shape[1]).reshape(shape).astype(float)
    # pixels that are covered between the points take their neighbours' shade
    near = uniform_filter(total, 3) / (uniform_filter(hits, 3) + 1e-9)
    shade = np.where(hits > 0, total / np.maximum(hits, 1), near)
    return shade.astype(np.float32), raster.coverage(points, front, shape)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), outward where the faces turn so: the area-weighted mean over the faces around."""
    of_faces = _face_normals(vertices, faces)
    corners, count = faces.T.ravel(), len(vertices)
    total = np.stack([np.bincount(corners, np.tile(c, 3), count) for c in of_faces.T], 1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def _face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals (F, 3), twice the faces' areas long."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.cross(b - a, c - a)


def _turn(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Twice the signed area of each face in the image, shape (F,): below 0 where it turns its outside to the viewer."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _placement(
    vertices: np.ndarray,
    axis: np.ndarray,
    tilt: float,
    rng: np.random.Generator,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and shift of the solid, in units of the image's side, that keep it in the picture."""
    chord = axis[-1] - axis[0]
    along = turn_z(-np.arctan2(chord[1], chord[0]))
    angle = np.radians(tilt) * rng.choice([-1.0, 1.0])
    c, s = np.cos(angle), np.sin(angle)
    turn = turn_z(rng.uniform(0, 2 * np.pi)) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ along
    seen = vertices @ turn.T
    low, high = seen[:, :2].min(0), seen[:, :2].max(0)
    extent = rng.uniform(0.45, 0.75)
    scale = extent / (high - low).max()
    free = 1 - 2 * MARGIN - scale * (high - low)
    corner = MARGIN + rng.uniform(0, 1, 2) * free
    depth = (axis @ turn.T)[:, 2].mean()
    return scale, turn, np.append(corner - scale * low, -scale * depth)


def turn_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _look(
    rng: np.random.Generator,
    size: int,
    contrast: str,
    colour: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direction to the light (3,), colour of the solid (k,) and background (size, size, k); k is 3 or 1."""
    light = light_from(rng)
    across, strength = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 0.04)
    bright, dark = rng.uniform(0.8, 0.95), rng.uniform(0.3, 0.4)
    solid, behind = (bright, 0.06) if contrast == "bright" else (dark, 0.85)
    hues = rng.uniform(0.75, 1.0, (2, 3)) if colour else np.ones((2, 1))
    hues /= hues.max(1, keepdims=True)
    x = np.linspace(-1, 1, size)
    ramp = strength * (np.cos(across) * x + np.sin(across) * x[:, None])
    return light, solid * hues[0], (behind + ramp)[..., None] * hues[1]


def light_from(rng: np.random.Generator) -> np.ndarray:
    """A direction to the light, shape (3,), 10 to 45 degrees off the viewer."""
    off, around = np.radians(rng.uniform(10, 45)), rng.uniform(0, 2 * np.pi)
    return np.array([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), -np.cos(off)])


def mean_radius(solid: shapes.Sweep, count: int) -> np.ndarray:
    """Radius of a solid at `count` even stations, shape (count,), in lengths of its axis."""
    return np.interp(np.linspace(0, 1, count), solid.station, solid.radius)


def rough_clicks(spine: np.ndarray, error: float, rng: np.random.Generator) -> np.ndarray:
    """Five image points (5, 2) along an axis (n, 3), with a standard deviation of `error` [px] in each coordinate."""
    at = np.linspace(0.12, 0.88, 5) * (len(spine) - 1)
    exact = np.stack([np.interp(at, np.arange(len(spine)), c) for c in spine[:, :2].T], 1)
    return exact + error * rng.standard_normal(exact.shape)


def write_squash(folder: Path) -> None:
    """Write squash.jpg and truth.npz: a crook-necked squash on a table, and its true mesh and axis."""
    height, width = 480, 640
    solid = shapes.sweep("squash", np.random.default_rng(SQUASH_SEED))
    vertices, faces, axis = _laid(solid, SQUASH_ANGLE, SQUASH_LENGTH, (width / 2, height / 2))
    shade, cover = render(vertices, faces, (height, width), TABLE_LIGHT, ambient=0.42, gloss=0.22)
    image = table_top(cover) * (1 - cover[..., None]) + _rind(axis, cover.shape) * (shade * cover)[..., None]
    _save(image, folder / "squash.jpg", 5)
    np.savez_compressed(
        folder / "truth.npz",
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint16),
        spine=axis,
        radius=SQUASH_LENGTH * mean_radius(solid, len(axis)),
        length=SQUASH_LENGTH,
        volume=volume(vertices, faces),
    )


def write_still_life(folder: Path) -> None:
    """Write still_life.jpg and truth.npz: the paper's figure 6, a pear and a potato on a table; their true outlines."""
    height, width = 480, 640
    image, covers, outlines = np.zeros((height, width, 3)), np.zeros((height, width)), {}
    for name, (kind, seed, angle, length, place, hue, blotch) in STILL_LIFE.items():
        solid = shapes.sweep(kind, np.random.default_rng(seed))
        vertices, faces, _ = _laid(solid, angle, length, place)
        shade, cover = render(vertices, faces, (height, width), TABLE_LIGHT, ambient=0.42, gloss=0.2, samples=4)
        spots = gaussian_filter(np.random.default_rng(seed).standard_normal(cover.shape), 5) * 10 * np.sqrt(np.pi)
        skin = np.array(hue) * (1 + blotch * spots[..., None])
        image = image * (1 - cover[..., None]) + skin * (shade * cover)[..., None]
        covers = np.maximum(covers, cover)
        outlines[name] = max(measure.find_contours(cover, 0.5), key=len)[:-1, ::-1]
    _save(table_top(covers) * (1 - covers[..., None]) + image, folder / "still_life.jpg", 6)
    np.savez_compressed(folder / "truth.npz", **outlines)


def _laid(
    solid: shapes.Sweep, angle: float, length: float, place: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and axis of a solid turned by an angle, its middle at an image point."""
    vertices, faces = shapes.mesh(solid, around=96, along=128)
    axis = np.column_stack([solid.axis[::20], np.zeros(len(solid.axis[::20]))])
    turn = turn_z(angle)
    seen = (vertices @ turn.T)[:, :2]
    middle = np.append(seen.max(0) + seen.min(0), 0) / 2
    vertices, axis = (length * (p @ turn.T - middle) + [*place, 0] for p in (vertices, axis))
    return vertices, faces, axis


def _save(image: np.ndarray, path: Path, seed: int) -> None:
    """An image (H, W, 3) with a little noise, as JPEG."""
    image = image + 0.01 * np.random.default_rng(seed).standard_normal(image.shape)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(np.uint8(np.round(255 * np.clip(image, 0, 1))))
    picture.save(path, quality=92, subsampling=0)


def table_top(cover: np.ndarray) -> np.ndarray:
    """A dark grey-blue table, lighter towards the light, with the shadow of what lies on it, (H, W, 3)."""
    y, x = np.mgrid[: cover.shape[0], : cover.shape[1]] / max(cover.shape)
    glow = 0.75 + 0.6 * np.exp(-((x - 0.2) ** 2 + (y - 0.05) ** 2) / 0.35)
    wide = gaussian_filter(shift(cover, (26, 20), order=1), 15)
    close = gaussian_filter(shift(cover, (8, 6), order=1), 5)
    return (glow * (1 - 0.5 * wide) * (1 - 0.35 * close))[..., None] * np.array([0.15, 0.18, 0.23])


def _rind(axis: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Warm yellow with faint blotches, greener towards the neck's tip, (H, W, 3)."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    from_tip = np.hypot(x - axis[0, 0], y - axis[0, 1]) / SQUASH_LENGTH
    green = (0.8 * np.exp(-((from_tip / 0.16) ** 2)))[..., None]
    blotches = gaussian_filter(np.random.default_rng(4).standard_normal(shape), 7) * 7 * np.sqrt(np.pi) * 2
    paint = (1 - green) * np.array([0.97, 0.72, 0.17]) + green * np.array([0.50, 0.56, 0.20])
    return paint * (1 + 0.025 * blotches[..., None])


if __name__ == "__main__":
    write_squash(Path(__file__).parent / "squash")
    write_still_life(Path(__file__).parent / "snake")
