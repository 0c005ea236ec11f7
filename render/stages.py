"""Several objects together, as in the paper's figures 2, 10 and 13: from axes given to solids, and once round them."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from .figures import grid
from .lines import Colour, Pen, Polylines, dashes, stroke
from .overlay import Photo
from .raster import Renderer, Viewpoint
from .text import write_text

_PAPER, _INK, _WORDS = (250, 250, 248), (40, 44, 52), (190, 198, 208)
_ASPECT = (0.6, 2.0)  # of a panel, width over height, at the least and the most
_SIDE = 62.0  # azimuth of the side view, degrees: at 90 a row of figures hides itself
_ELEVATION = 9.0


@dataclass(frozen=True)
class Stage:
    """One object at its start and at its end; image points are (column, row), world points (x, y, z)."""

    colour: Colour
    spine_first: np.ndarray
    """the axis given, shape (n, 2), image."""
    spine_last: np.ndarray
    """the spine found, shape (n, 2), image."""
    first: tuple[np.ndarray, np.ndarray]
    """mesh of the first tube, vertices (V, 3), faces (F, 3), world."""
    last: tuple[np.ndarray, np.ndarray]
    """of the last."""
    wire: Polylines = ()
    """of the last, shape (n, 3) each, world."""


def stages_sheet(
    image: np.ndarray, objects: Sequence[Stage], front: np.ndarray | None = None, width: int = 900
) -> np.ndarray:
    """Six panels, shape (H, W, 3), uint8: axes given, first tubes, spines found, wire frames, front and side.

    Args:
        image: the photograph, shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        objects: of the scene.
        front: rotation, shape (3, 3), from the world to the photograph's (right, down, away), if they differ.
        width: of a panel, px.
    """
    size = (width, round(width / np.clip(image.shape[1] / image.shape[0], *_ASPECT)))
    front = np.eye(3) if front is None else front
    first, last = ([(*getattr(o, which), o.colour) for o in objects] for which in ("first", "last"))
    points = np.concatenate([part[0] for part in (*first, *last)])
    ahead = framed(points, size, front=front)
    aside = framed(points, size, _SIDE, _ELEVATION, front)
    photo = Photo(image, size, _window(image.shape, size))
    panels = [(_axes(photo, objects, False), "axes given", _INK)]
    with Renderer(*size, supersample=3) as renderer:
        panels.append((renderer.shade(first, ahead), "first tubes", _WORDS))
        panels.append((_axes(photo, objects, True), "spines found", _INK))
        wires = renderer.wires(last, ahead, [o.wire for o in objects], _PAPER)
        panels.append((wires, "wire frames", _INK))
        panels.append((renderer.shade(last, ahead), "front", _WORDS))
        panels.append((renderer.shade(last, aside), f"from {_SIDE:.0f} degrees to the right", _WORDS))
    for picture, words, colour in panels:
        write_text(picture, (width * 0.015, size[1] - width * 0.04), words, width / 42, colour)
    return grid([picture for picture, _, _ in panels], 2, gap=2, colour=(16, 19, 24))


def turning_frames(
    meshes: Sequence[tuple[np.ndarray, np.ndarray, Colour]],
    front: np.ndarray | None = None,
    frames: int = 400,
    size: tuple[int, int] = (960, 600),
) -> Generator[np.ndarray]:
    """Yield frames, shape (height, width, 3), uint8: all objects together, once round.

    Args:
        meshes: (vertices (V, 3) world, faces (F, 3), sRGB colour) each.
        front: as in `stages_sheet`.
        frames: of the whole turn.
        size: width and height, px.

    Raises:
        RenderError: there is no OpenGL.
    """
    front = np.eye(3) if front is None else front
    points = np.concatenate([vertices for vertices, _, _ in meshes])
    with Renderer(*size) as renderer:
        for azimuth in 360.0 * np.arange(frames) / frames:
            yield renderer.shade(meshes, framed(points, size, azimuth, _ELEVATION, front))


def framed(
    points: np.ndarray, size: tuple[int, int], azimuth: float = 0.0, elevation: float = 0.0, front: np.ndarray | None = None
) -> Viewpoint:
    """From where a picture of a size in px holds points, shape (n, 3), whatever the azimuth: one framing for a turn."""
    front = np.eye(3) if front is None else front
    seen = points @ front.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    away = seen - middle
    around = float(np.hypot(away[:, 0], away[:, 2]).max())
    e = np.radians(elevation)
    up = float(np.abs(away[:, 1]).max() * np.cos(e) + around * np.sin(e))
    radius = max(around / size[0], up / size[1], 1e-12) * min(size)
    return Viewpoint(middle @ front, radius, azimuth, elevation, front)


def _window(shape: tuple[int, ...], size: tuple[int, int]) -> tuple[float, float, float, float]:
    """All of a photograph, with dark bars where its aspect is not the picture's."""
    height, width = shape[:2]
    scale = max(width / size[0], height / size[1])
    x, y = (width - 1) / 2, (height - 1) / 2
    return x - scale * size[0] / 2, y - scale * size[1] / 2, x + scale * size[0] / 2, y + scale * size[1] / 2


def _axes(photo: Photo, objects: Sequence[Stage], last: bool) -> np.ndarray:
    """The photograph, paled, with the axes of all objects, in their colours; those given dashed, with their points."""
    picture = np.uint8(np.rint(photo.picture * 0.45 + 255 * 0.55))
    picture = np.ascontiguousarray(picture)
    unit = picture.shape[1] / 640
    for o in objects:
        line = photo.place(o.spine_last if last else o.spine_first)
        parts = [line] if last else dashes(line, 5 * unit, 3 * unit)
        stroke(picture, parts, Pen(_INK, 2.6 * unit, 0.8), Pen(o.colour, 1.5 * unit))
        if not last:
            stroke(picture, [point[None] for point in line], Pen(_INK, 4.4 * unit, 0.8), Pen(o.colour, 3.2 * unit))
    return picture
