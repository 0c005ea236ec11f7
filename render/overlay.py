"""A fitted model drawn over its photograph."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from .lines import Colour, Pen, Polylines, dashes, runs, stroke
from .text import plate, text_size, write_text

WIRE: Colour = (255, 255, 255)
SUPPORTED: Colour = (0, 229, 255)
UNSUPPORTED: Colour = (255, 84, 150)
SPINE_FIRST: Colour = (255, 255, 255)
SPINE_LAST: Colour = (255, 222, 60)
PULL: Colour = (255, 148, 40)
_DARK: Colour = (12, 16, 24)

_CRAMPED = 1.12  # window over object, at the least

SHEET, GAP = 2400, 6
"""Height of pictures side by side times their columns, and what lies between them, px."""

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
    spine_first: np.ndarray | None = None
    """the axis that the user gave."""
    spine_last: np.ndarray | None = None
    """the axis that was found."""
    colour: Colour = SUPPORTED
    """of the contour."""
    line: bool = False
    """what the user gave is a curve rather than an axis."""
    pulls: Polylines = ()
    """springs that hold it, from it to their anchors."""
    hidden: Sequence[np.ndarray] = ()
    """for each polyline of the contour, bool, shape (n,): another object hides the point, which is dashed; empty: none."""


class Photo:
    """A photograph, or a window of it, scaled to a picture of a given size.

    Args:
        image: shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        size: (width, height) of the picture, px.
        window: (left, top, right, bottom) in the photograph's points, all of it being (-1/2, -1/2, W - 1/2,
            H - 1/2), as pixel centres lie at whole numbers. What lies outside the photograph is dark.
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
        # Pillow's box counts from the outer corner of the first pixel: the half pixel
        box = (left + 0.5, top + 0.5, right + 0.5, bottom + 0.5)
        beyond = math.ceil(max(0.0, -box[0], -box[1], box[2] - width, box[3] - height))
        if beyond:
            channels = [np.pad(pixels[..., k], beyond, constant_values=_DARK[k]) for k in range(3)]
            pixels = np.stack(channels, axis=2)
            box = (box[0] + beyond, box[1] + beyond, box[2] + beyond, box[3] + beyond)
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


def draw_overlay(image: np.ndarray, drawings: Sequence[Drawing], legend: bool = True, caption: str = "") -> np.ndarray:
    """A photograph with models drawn over it, shape (h, w, 3), uint8, long side 960 to 1600 px.

    Args:
        image: shape (H, W) or (H, W, 3), float in [0, 1] or uint8.
        drawings: one for each object.
        legend: whether to say in the emptiest corner what the colours mean.
        caption: written below the upper border.
    """
    photo = Photo.sized(image)
    picture = photo.picture
    width = line_width(photo, drawings)
    for drawing in drawings:
        draw(picture, photo, drawing, width)
    if legend:
        _legend(picture, photo, drawings, max(picture.shape[:2]) / 640)
    if caption:
        size = 12 * max(picture.shape[:2]) / 640
        width, height = text_size(caption, size)
        left, top, pad = (picture.shape[1] - width) // 2, round(size / 2), round(size / 2)
        plate(picture, (left - pad, top - pad // 2, left + width + pad, top + height + pad // 2), _DARK, 0.72, pad)
        write_text(picture, (left, top), caption, size)
    return picture


def side_by_side(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures (h, w, 3), uint8, in rows of about the square root of their number, reduced to `SHEET` px in all."""
    if len(pictures) == 1:
        return pictures[0]
    columns = math.ceil(math.sqrt(len(pictures)))
    height = min(SHEET // columns, *(p.shape[0] for p in pictures))
    scaled = [np.asarray(Image.fromarray(p).resize((round(height * p.shape[1] / p.shape[0]), height))) for p in pictures]
    width = max(p.shape[1] for p in scaled)
    rows = math.ceil(len(pictures) / columns)
    sheet = np.empty((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), np.uint8)
    sheet[:] = _DARK
    for i, p in enumerate(scaled):
        top, left = i // columns * (height + GAP), i % columns * (width + GAP)
        sheet[top : top + height, left : left + p.shape[1]] = p
    return sheet


def line_width(photo: Photo, drawings: Sequence[Drawing]) -> float:
    """Unit of line widths, px: goes with the picture's size, less where the objects are small in it."""
    side = max(photo.picture.shape[:2])
    spreads = [_spread(photo, drawing) / side for drawing in drawings]
    return side / 640 * float(np.clip(np.median(spreads or [1.0]) / 0.1, 0.55, 1.0))


def _spread(photo: Photo, drawing: Drawing) -> float:
    """Geometric mean of an object's standard deviations along its two axes, px: a turn does not change it."""
    points = photo.place(np.concatenate([np.zeros((0, 2)), *drawing.contour, *drawing.wire]))
    points = points[np.isfinite(points).all(axis=1)]
    return float(max(np.linalg.det(np.cov(points.T)), 0.0)) ** 0.25 if len(points) > 2 else 0.0


def window_around(
    points: np.ndarray, shape: tuple[int, ...], aspect: float = 1.0, margin: float = 1.45
) -> tuple[float, float, float, float]:
    """A window for Photo, `aspect` times as wide as high, that holds points, shape (n, 2), with room around.

    It stays within a photograph of this shape, (H, W) or (H, W, 3), as far as that is large enough.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    tight = max(high[1] - low[1], (high[0] - low[0]) / aspect, 8.0)
    # less room rather than dark bars, but never a cramped picture
    height = min(margin * tight, max(_CRAMPED * tight, min(shape[0], shape[1] / aspect)))
    half = np.array([height * aspect, height]) / 2
    size = np.array([shape[1], shape[0]], float)
    # nearest to the points that keeps the window on the photograph, else on its middle
    nearest, furthest = np.minimum(half, size / 2) - 0.5, np.maximum(size - half, size / 2) - 0.5
    x, y = np.clip((low + high) / 2, nearest, furthest)
    return x - half[0], y - half[1], x + half[0], y + half[1]


def draw(picture: np.ndarray, photo: Photo, drawing: Drawing, width: float) -> None:
    """Draw one object into a picture of the photograph, in place; `width` is the unit of line widths, px."""
    wire = _placed(photo, drawing.wire)
    stroke(picture, wire, Pen(_DARK, width * 1.4, 0.25), Pen(WIRE, width * 0.7, 0.75))
    if drawing.spine_first is not None:
        first = dashes(photo.place(drawing.spine_first), 5 * width, 4 * width)
        _haloed(picture, first, SPINE_FIRST, width * 0.9)
    if drawing.spine_last is not None:
        _haloed(picture, [photo.place(drawing.spine_last)], SPINE_LAST, width * 1.1)
    contour = _placed(photo, drawing.contour)
    support = drawing.support if len(drawing.support) else [np.ones(len(line), bool) for line in contour]
    hidden = drawing.hidden if len(drawing.hidden) else [np.zeros(len(line), bool) for line in contour]
    flagged = list(zip(contour, support, hidden, strict=True))
    for parts, colour, thick in (
        ([part for line, _, behind in flagged for part in runs(line, ~behind, False)], drawing.colour, 1.0),
        ([part for line, held, behind in flagged for part in runs(line, held | behind, False)], UNSUPPORTED, 1.6),
    ):
        _haloed(picture, [dash for part in parts for dash in dashes(part, 7 * width, 5 * width)], colour, width * thick)
    seen = [part for line, held, behind in flagged for part in runs(line, held & ~behind, True)]
    _haloed(picture, seen, drawing.colour, width * 1.6)
    pulls = _placed(photo, drawing.pulls)
    _haloed(picture, pulls, PULL, width * 1.3)
    _haloed(picture, [line[-1:] for line in pulls], PULL, width * 5)


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
    stroke(picture, lines, Pen(_DARK, width * 2.2, 0.4), Pen(colour, width))


def _legend(picture: np.ndarray, photo: Photo, drawings: Sequence[Drawing], width: float) -> None:
    """A key to the colours in the corner that least of the contours crosses."""
    entries = _entries(drawings)
    if not entries:
        return
    size = 10 * width
    line_height = text_size("x", size)[1] + round(2 * width)
    pad, sample = round(6 * width), round(22 * width)
    box = np.array([max(text_size(words, size)[0] for words, *_ in entries) + sample + 3 * pad, 0])
    box[1] = line_height * len(entries) + 2 * pad - round(2 * width)
    drawn = [photo.place(line) for drawing in drawings for line in drawing.contour]
    left, top = _emptiest_corner(picture.shape, box, round(9 * width), drawn)
    plate(picture, (left, top, left + int(box[0]), top + int(box[1])), _DARK, 0.72, pad)
    for index, (words, colour, thick, dashed) in enumerate(entries):
        y = top + pad + index * line_height
        line = np.array([[left + pad, y + line_height * 0.42], [left + pad + sample, y + line_height * 0.42]])
        parts = dashes(line, 5 * width, 4 * width) if dashed else [line]
        stroke(picture, parts, Pen(colour, thick * width))
        write_text(picture, (left + 2 * pad + sample, y), words, size)


def _entries(drawings: Sequence[Drawing]) -> list[tuple[str, Colour, float, bool]]:
    """(words, colour, width, dashed) of what the drawings hold."""
    behind = any(np.any(flags) for drawing in drawings for flags in drawing.hidden)
    loose = any(
        not np.all(flags | drawing.hidden[i] if len(drawing.hidden) else flags)
        for drawing in drawings
        for i, flags in enumerate(drawing.support)
    )
    colour = next((drawing.colour for drawing in drawings), SUPPORTED)
    return [
        entry
        for there, entry in (
            (
                any(len(d.contour) for d in drawings),
                ("contour, supported by the image", colour, 1.6, False),
            ),
            (behind, ("contour, hidden", colour, 1.0, True)),
            (loose, ("contour, unsupported", UNSUPPORTED, 1.6, True)),
            (any(len(d.wire) for d in drawings), ("model", WIRE, 0.7, False)),
            (any(d.spine_first is not None and not d.line for d in drawings), ("axis given", SPINE_FIRST, 0.9, True)),
            (any(d.spine_first is not None and d.line for d in drawings), ("curve given", SPINE_FIRST, 0.9, True)),
            (any(len(d.pulls) for d in drawings), ("spring", PULL, 1.3, False)),
            (any(d.spine_last is not None for d in drawings), ("axis found", SPINE_LAST, 1.1, False)),
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
