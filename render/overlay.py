"""A fitted model drawn over its photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from PIL import Image

from .lines import Colour, Polylines, dashes, runs, stroke
from .text import plate, text_size, write_text

WIRE: Colour = (255, 255, 255)
SUPPORTED: Colour = (0, 229, 255)
UNSUPPORTED: Colour = (255, 60, 140)
SPINE_FIRST: Colour = (255, 255, 255)
SPINE_LAST: Colour = (255, 222, 60)
_DARK: Colour = (12, 16, 24)

LONG_SIDE = (960, 1600)
"""px: smaller photographs are enlarged to the first, larger ones reduced to the second."""


@dataclass(frozen=True)
class Drawing:
    """What is drawn of one object. All points are (column, row) of the photograph, shape (n, 2)."""

    wire: Polylines = ()
    """the model's rings and meridians."""
    contour: Polylines = ()
    """its occluding contour."""
    support: Sequence[np.ndarray] = ()
    """for each polyline of the contour, bool, shape (n,): image data holds the point; empty: all of it."""
    spine_first: np.ndarray | None = field(default=None)
    """the axis that the user gave."""
    spine_last: np.ndarray | None = field(default=None)
    """the axis that was found."""


class Photo:
    """A photograph, or a window of it, scaled to a picture of a given size.

    Args:
        image: shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        size: (width, height) of the picture, px.
        window: (left, top, right, bottom) of the photograph's area, whose first pixel's centre is (0, 0) and whose
            left edge is therefore at -1/2; the whole photograph if not given.
    """

    def __init__(
        self,
        image: np.ndarray,
        size: tuple[int, int],
        window: tuple[float, float, float, float] | None = None,
    ):
        pixels = as_rgb(image)
        height, width = pixels.shape[:2]
        self.window = window or (-0.5, -0.5, width - 0.5, height - 0.5)
        left, top, right, bottom = self.window
        self.scale = np.array([size[0] / (right - left), size[1] / (bottom - top)])
        # Pillow's box counts from the left edge of the first pixel: the half pixel
        box = (left + 0.5, top + 0.5, right + 0.5, bottom + 0.5)
        scaled = Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC, box=box)
        self.picture = np.asarray(scaled).copy()

    @classmethod
    def sized(cls, image: np.ndarray) -> Photo:
        """The whole photograph, its long side brought between the two values of LONG_SIDE."""
        height, width = image.shape[:2]
        scale = float(np.clip(max(height, width), *LONG_SIDE)) / max(height, width)
        return cls(image, (max(1, round(width * scale)), max(1, round(height * scale))))

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points of the photograph (column, row), shape (n, 2), as points of the picture.

        From the window's edge, so a photograph's pixel p covers p - 1/2 to p + 1/2 and so does a picture's.
        """
        return (np.asarray(points, float).reshape(-1, 2) - self.window[:2]) * self.scale - 0.5


def draw_overlay(image: np.ndarray, drawings: Sequence[Drawing], legend: bool = True) -> np.ndarray:
    """A photograph with models drawn over it, shape (h, w, 3), uint8, long side 960 to 1600 px.

    Args:
        image: shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        drawings: one for each object.
        legend: whether to say in the emptiest corner what the colours mean.
    """
    photo = Photo.sized(image)
    picture = photo.picture
    width = max(picture.shape[:2]) / 640
    for drawing in drawings:
        draw(picture, photo, drawing, width)
    if legend:
        _legend(picture, [photo.place(line) for drawing in drawings for line in drawing.contour], drawings, width)
    return picture


def draw(picture: np.ndarray, photo: Photo, drawing: Drawing, width: float) -> None:
    """Draw one object into a picture of the photograph, in place; `width` of the contour in px."""
    wire = _placed(photo, drawing.wire)
    stroke(picture, wire, _DARK, width * 1.0, alpha=0.2)
    stroke(picture, wire, WIRE, width * 0.5, alpha=0.7)
    if drawing.spine_first is not None:
        _haloed(picture, dashes(photo.place(drawing.spine_first), 5 * width, 4 * width), SPINE_FIRST, width * 0.9)
    if drawing.spine_last is not None:
        _haloed(picture, [photo.place(drawing.spine_last)], SPINE_LAST, width * 0.9)
    contour = _placed(photo, drawing.contour)
    support = drawing.support if len(drawing.support) else [np.ones(len(line), bool) for line in contour]
    held = [part for line, flags in zip(contour, support, strict=True) for part in runs(line, flags, True)]
    free = [part for line, flags in zip(contour, support, strict=True) for part in runs(line, flags, False)]
    _haloed(picture, [dash for part in free for dash in dashes(part, 5 * width, 4 * width)], UNSUPPORTED, width * 1.6)
    _haloed(picture, held, SUPPORTED, width * 1.6)


def as_rgb(image: np.ndarray) -> np.ndarray:
    """Any image, shape (H, W) or (H, W, 3), float in [0, 1] or uint8, as (H, W, 3), uint8."""
    image = np.asarray(image)
    if image.dtype != np.uint8:
        image = np.rint(np.clip(np.nan_to_num(image), 0.0, 1.0) * 255).astype(np.uint8)
    return np.ascontiguousarray(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2))


def _placed(photo: Photo, lines: Polylines) -> list[np.ndarray]:
    return [photo.place(line) for line in lines]


def _haloed(picture: np.ndarray, lines: Polylines, colour: Colour, width: float) -> None:
    """A line with a dark rim, which reads on any ground."""
    stroke(picture, lines, _DARK, width * 2.2, alpha=0.4)
    stroke(picture, lines, colour, width)


def _legend(picture: np.ndarray, drawn: Polylines, drawings: Sequence[Drawing], width: float) -> None:
    """A key to the colours in the corner that least of the contours crosses."""
    entries = _entries(drawings)
    if not entries:
        return
    size = 10 * width
    line_height = text_size("x", size)[1] + round(2 * width)
    pad, sample = round(6 * width), round(22 * width)
    box = np.array([max(text_size(words, size)[0] for words, *_ in entries) + sample + 3 * pad, 0])
    box[1] = line_height * len(entries) + 2 * pad - round(2 * width)
    left, top = _emptiest_corner(picture.shape, box, round(9 * width), drawn)
    plate(picture, (left, top, left + int(box[0]), top + int(box[1])), _DARK, 0.72, pad)
    for index, (words, colour, thick, dashed) in enumerate(entries):
        y = top + pad + index * line_height
        line = np.array([[left + pad, y + line_height * 0.42], [left + pad + sample, y + line_height * 0.42]])
        stroke(picture, dashes(line, 5 * width, 4 * width) if dashed else [line], colour, thick * width)
        write_text(picture, (left + 2 * pad + sample, y), words, size)


def _entries(drawings: Sequence[Drawing]) -> list[tuple[str, Colour, float, bool]]:
    """(words, colour, width, dashed) of what the drawings hold."""
    loose = any(not np.all(flags) for drawing in drawings for flags in drawing.support)
    return [
        entry
        for there, entry in (
            (any(len(d.contour) for d in drawings), ("contour, held by the image", SUPPORTED, 1.6, False)),
            (loose, ("contour, not held", UNSUPPORTED, 1.6, True)),
            (any(len(d.wire) for d in drawings), ("model", WIRE, 0.7, False)),
            (any(d.spine_first is not None for d in drawings), ("axis given", SPINE_FIRST, 0.9, True)),
            (any(d.spine_last is not None for d in drawings), ("axis found", SPINE_LAST, 0.9, False)),
        )
        if there
    ]


def _emptiest_corner(shape: tuple[int, ...], box: np.ndarray, gap: int, drawn: Polylines) -> tuple[int, int]:
    """Left and top of a box in the corner where the fewest points lie."""
    points = np.concatenate([np.zeros((0, 2)), *drawn])
    right, bottom = shape[1] - gap - int(box[0]), shape[0] - gap - int(box[1])
    corners = [(gap, bottom), (right, bottom), (gap, gap), (right, gap)]

    def crossing(corner: tuple[int, int]) -> int:
        inside = (points >= np.asarray(corner) - gap) & (points <= np.asarray(corner) + box + gap)
        return int(inside.all(axis=1).sum())

    return min(corners, key=crossing)
