"""Small text on pictures."""

from __future__ import annotations

from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .lines import Colour


@cache
def font(size: float) -> ImageFont.FreeTypeFont:
    """Pillow's own font, px."""
    chosen = ImageFont.load_default(size)
    if not isinstance(chosen, ImageFont.FreeTypeFont):
        raise RuntimeError("Pillow was built without FreeType; install one of its wheels")
    return chosen


def text_size(words: str, size: float) -> tuple[int, int]:
    """Width of the words and height of a line of this size, px."""
    ascent, descent = font(size).getmetrics()
    return int(np.ceil(font(size).getlength(words))), ascent + descent


def write_text(
    image: np.ndarray, place: tuple[float, float], words: str, size: float, colour: Colour = (235, 238, 242)
) -> None:
    """Write a line into an image, shape (H, W, 3), uint8, in place; its top left is `place` (column, row)."""
    width, height = text_size(words, size)
    left, top = round(place[0]), round(place[1])
    patch = image[max(top, 0) : top + height, max(left, 0) : left + width]
    if patch.size == 0:
        return
    drawn = Image.fromarray(np.ascontiguousarray(patch))
    ImageDraw.Draw(drawn).text((left - max(left, 0), top - max(top, 0)), words, fill=colour, font=font(size))
    patch[:] = np.asarray(drawn)


def plate(image: np.ndarray, box: tuple[int, int, int, int], colour: Colour, alpha: float, radius: int = 6) -> None:
    """Lay a translucent plate with round corners over (left, top, right, bottom) of an image, in place."""
    left, top, right, bottom = box
    patch = image[max(top, 0) : bottom, max(left, 0) : right]
    if patch.size == 0:
        return
    fine = Image.new("L", (4 * patch.shape[1], 4 * patch.shape[0]))
    ImageDraw.Draw(fine).rounded_rectangle((0, 0, fine.width - 1, fine.height - 1), 4 * radius, fill=255)
    share = alpha * (np.asarray(fine.reduce(4)) / np.float32(255))[..., None]
    patch[:] = np.rint(patch + share * (np.asarray(colour, np.float32) - patch))
