"""Sheets of pictures: a model from several sides, and the potentials as in the paper's figure 8."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from .lines import Polylines
from .raster import Meshes, Renderer, Viewpoint, bounding_sphere
from .text import text_size, write_text

VIEWS = (
    ("front", 0.0, 0.0),
    ("three-quarter", 40.0, 22.0),
    ("side", 90.0, 0.0),
    ("back", 205.0, 12.0),
    ("top", 0.0, 90.0),
)
"""(name, azimuth, elevation in degrees) on the sheet; the wire frame comes last, seen as the second."""

_PAPER, _INK, _FAINT = (250, 250, 248), (40, 44, 52), (205, 207, 210)


def views_sheet(
    meshes: Meshes, wire: Polylines = (), front: np.ndarray | None = None, tile: int = 520, columns: int = 3
) -> np.ndarray:
    """Shaded views of the meshes from several sides at one scale, shape (H, W, 3), uint8.

    Args:
        meshes: (vertices (V, 3) world, faces (F, 3), sRGB colour) each.
        wire: polylines in the world, shape (n, 3) each, for the wire-frame view.
        front: rotation, shape (3, 3), from the world to the front view's (right, down, away), if they differ.
        tile: side of a view, px.
        columns: views in a row.
    """
    centre, radius = bounding_sphere(*(vertices for vertices, _, _ in meshes))
    front = np.eye(3) if front is None else front
    shots: list[tuple[str, float, float, Polylines]] = [(*view, ()) for view in VIEWS]
    if len(wire):
        _, azimuth, elevation = VIEWS[1]
        shots.append(("wire frame", azimuth, elevation, wire))
    tiles = []
    with Renderer(tile, tile, supersample=3) as renderer:
        for name, azimuth, elevation, lines in shots:
            picture = renderer.shade(meshes, Viewpoint(centre, radius, azimuth, elevation, front), lines)
            write_text(picture, (tile * 0.035, tile * 0.925), name, tile / 26, (190, 198, 208))
            tiles.append(picture)
    return grid(tiles, columns, gap=2, colour=(16, 19, 24))


def potentials_sheet(
    potentials: Sequence[tuple[float, np.ndarray]], foreground: np.ndarray | None = None, tile: int = 360
) -> np.ndarray:
    """The potentials in a row, coarse to fine as given, as in the paper's figure 8, shape (H, W, 3), uint8.

    Dark is a strong gradient; each picture is rescaled to span the range from white to black.

    Args:
        potentials: (sigma in px, strength shape (h, w), larger is stronger) each.
        foreground: how likely each pixel is the object's, shape (h, w), in [0, 1]; black is object.
        tile: height of a picture, px.
    """
    labelled = [(f"sigma {sigma:.3g} px", _spanning(strength)) for sigma, strength in potentials]
    if foreground is not None:
        labelled.insert(0, ("foreground map", np.clip(foreground, 0.0, 1.0)))
    plates = [_plate(words, darkness, tile) for words, darkness in labelled]
    return grid(plates, len(plates), gap=14, colour=_PAPER)


def _spanning(strength: np.ndarray) -> np.ndarray:
    """Rescaled to [0, 1]; a constant image becomes 0."""
    low, high = np.nanmin(strength), np.nanmax(strength)
    return np.nan_to_num((strength - low) / (high - low)) if high > low else np.zeros(np.shape(strength))


def _plate(words: str, darkness: np.ndarray, height: int) -> np.ndarray:
    """A grey picture in a thin frame, its label below."""
    width = max(1, round(height * darkness.shape[1] / darkness.shape[0]))
    grey = Image.fromarray(np.rint(255 * (1 - darkness)).astype(np.uint8))
    inner = np.asarray(grey.resize((width, height), Image.Resampling.BICUBIC))[..., None]
    size = height / 20
    room = round(text_size(words, size)[1] * 1.6)
    plate = np.full((height + 2 + room, width + 2, 3), _PAPER, np.uint8)
    plate[: height + 2] = _FAINT
    plate[1 : height + 1, 1 : width + 1] = inner
    left = (width + 2 - text_size(words, size)[0]) / 2
    write_text(plate, (left, height + 2 + room * 0.2), words, size, _INK)
    return plate


def grid(tiles: Sequence[np.ndarray], columns: int, gap: int, colour: tuple[int, int, int]) -> np.ndarray:
    """Tiles in rows, with gaps between and around; short rows and small tiles leave the ground bare."""
    height = max(tile.shape[0] for tile in tiles) + gap
    width = max(tile.shape[1] for tile in tiles) + gap
    rows = -(-len(tiles) // columns)
    sheet = np.full((rows * height + gap, min(columns, len(tiles)) * width + gap, 3), colour, np.uint8)
    for index, tile in enumerate(tiles):
        top, left = gap + index // columns * height, gap + index % columns * width
        sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    return sheet
