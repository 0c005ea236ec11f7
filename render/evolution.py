"""The film of a reconstruction: from the first tube to the final shape, then once around it."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from .lines import Colour
from .overlay import Drawing, Photo, draw, line_width, window_around
from .raster import Renderer, Viewpoint, bounding_sphere
from .text import plate, text_size, write_text

_ELEVATION = 14.0
_FIRST, _LAST = 20.0, 50.0  # azimuth while the model deforms; the turn goes on from there
_LARGEST = 1.5  # radii of the final shape: a tube that swells beyond it for a while may leave the picture


@dataclass(frozen=True)
class Snapshot:
    """One object, or several, at one moment of a reconstruction."""

    drawings: Sequence[Drawing]
    """what is drawn over the photograph, one for each object."""
    meshes: Sequence[tuple[np.ndarray, np.ndarray]]
    """(vertices (V, 3) world, faces (F, 3)) of each object."""
    label: str = ""
    """such as "sigma 4 px"."""


def evolution_frames(
    image: np.ndarray,
    snapshots: Sequence[Snapshot],
    colours: Sequence[Colour] = ((226, 142, 52),),
    fps: float = 25,
    seconds: tuple[float, float, float] = (3.6, 0.6, 4.2),
    panel: int = 640,
    front: np.ndarray | None = None,
) -> Generator[np.ndarray]:
    """Yield frames, shape (panel, 2 panel, 3), uint8: left the model on the photograph, right the solid.

    Without any mesh only the photograph, shape (panel, panel, 3), and no turn.

    Args:
        image: the photograph, shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        snapshots: first to last; shown evenly over the first part.
        colours: sRGB of the objects, taken in turn.
        fps: frames per second.
        seconds: length of the deformation, of the rest on the final shape and of the turn around it, s.
        panel: side of a panel, px, even.
        front: rotation, shape (3, 3), from the world to the photograph's (right, down, away), if they differ.

    Raises:
        ValueError: there is no snapshot.
        RenderError: there is no OpenGL.
    """
    if not snapshots:
        raise ValueError("a film needs at least one snapshot")
    deform, rest, turn = (max(1, round(part * fps)) for part in seconds)
    azimuths = [*np.linspace(_FIRST, _LAST, deform + rest), *_eased(turn)]
    final = len(snapshots) - 1
    shown = [*np.rint(np.linspace(0, final, deform)).astype(int), *[final] * (rest + turn)]
    photo = Photo(image, (panel, panel), _window(image, snapshots))
    width = 1.2 * line_width(photo, snapshots[-1].drawings)  # a film's lines are blurred by its coding
    if not any(len(snapshot.meshes) for snapshot in snapshots):
        pictures = [_left(photo, snapshot, width) for snapshot in snapshots]
        yield from (pictures[i].copy() for i in shown[: deform + rest])
        return
    centre, radius = _framing(snapshots)
    front = np.eye(3) if front is None else front
    frame = np.zeros((panel, 2 * panel, 3), np.uint8)
    last = -1
    with Renderer(panel, panel) as renderer:
        for index, azimuth in zip(shown, azimuths, strict=True):
            snapshot = snapshots[index]
            if index != last:
                frame[:, :panel] = _left(photo, snapshot, width)
                last = index
            meshes = [(*mesh, colours[k % len(colours)]) for k, mesh in enumerate(snapshot.meshes)]
            frame[:, panel:] = renderer.shade(meshes, Viewpoint(centre, radius, azimuth, _ELEVATION, front))
            frame[:, panel - 1 : panel + 1] = (16, 19, 24)
            yield frame.copy()


def _eased(count: int) -> np.ndarray:
    """Azimuths of a full turn from _LAST that starts and ends softly."""
    t = (np.arange(count) + 1) / count
    soft = 0.12  # share of the time for gaining speed, and again for losing it
    speed = np.minimum(np.minimum(t, 1 - t + 1 / count) / soft, 1.0)
    return _LAST + 360.0 * np.cumsum(speed) / speed.sum()


def _left(photo: Photo, snapshot: Snapshot, width: float) -> np.ndarray:
    picture = photo.picture.copy()
    panel = len(picture)
    for drawing in snapshot.drawings:
        draw(picture, photo, drawing, width)
    if snapshot.label:
        size = panel / 34
        width, height = text_size(snapshot.label, size)
        left, top, pad = round(panel * 0.025), round(panel * 0.975) - height, round(size / 2)
        plate(picture, (left, top - pad, left + width + 2 * pad, top + height), (12, 16, 24), 0.6)
        write_text(picture, (left + pad, top - pad / 2), snapshot.label, size)
    return picture


def _window(image: np.ndarray, snapshots: Sequence[Snapshot]) -> tuple[float, float, float, float]:
    """The part of the photograph that the film shows: around the first and the final model."""
    lines = [
        line
        for snapshot in (snapshots[0], snapshots[-1])
        for drawing in snapshot.drawings
        for line in (*drawing.wire, *drawing.contour)
    ]
    if not lines:
        lines = [np.array([[0, 0], [image.shape[1], image.shape[0]]])]
    points = np.concatenate(lines)
    return window_around(points[np.isfinite(points).all(axis=1)], image.shape)


def _framing(snapshots: Sequence[Snapshot]) -> tuple[np.ndarray, float]:
    """One sphere for the whole film, centred on the final shape."""
    centre, radius = bounding_sphere(*(vertices for vertices, _ in snapshots[-1].meshes))
    every = np.concatenate([vertices for snapshot in snapshots for vertices, _ in snapshot.meshes])
    reach = float(np.nanmax(np.linalg.norm(every - centre, axis=1)))
    return centre, min(max(reach, radius), _LARGEST * radius)
