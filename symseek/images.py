"""Photographs from files, from scikit-image and from arrays, as float32 in [0, 1].

Files are anything Pillow or tifffile reads, and .npy. The EXIF turn is applied. Whole numbers are divided by
the range of their kind (8 or 16 bits); floats must lie in [0, 1] already. An alpha channel is laid over mid
grey (0.5).
"""

from __future__ import annotations

import importlib.util
import os
import warnings
from pathlib import Path
from typing import NoReturn

import numpy as np

from .checks import SceneError, Table, shown, suggest

MEGAPIXELS_MAX = 100
SIDE_MIN = 16  # px
CONTRAST_MIN = 1 / 256  # between the darkest and the brightest pixel
BACKGROUND = 0.5  # grey below an alpha channel


def read(table: Table, key: str, base: Path, mask: bool = False) -> np.ndarray:
    """The image that `key` names or is.

    Args:
        table: the [[view]] table, for the value and for messages.
        key: "image" or "ignore". Text is a path relative to `base`, in which $NAME is an environment
            variable, or "skimage:NAME", a picture that ships with scikit-image. An array, shape (H, W) or
            (H, W, 1 to 4), will also do.
        base: folder of the scene file.
        mask: read it grey and let it be of one value.

    Returns:
        shape (H, W) or (H, W, 3), float32 in [0, 1].

    Raises:
        SceneError: missing, not an image, empty, too large or small, one grey value, NaN, out of [0, 1].
    """
    value = table.take(key, why='name the photograph: image = "photo.jpg"')
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, np.ndarray):
        pixels = value
    elif not isinstance(value, str) or not value.strip():
        table.fail(key, f"{shown(value)} is not a path", 'write it in quotes, like "photo.jpg"')
    elif value.startswith("skimage:"):
        pixels = _from_skimage(table, key, value)
    else:
        pixels = _from_file(table, key, value, base)
    named = f"{value!r} " if isinstance(value, str) else "the array "
    pixels = _unit(table, key, named, pixels)
    if mask:
        return pixels if pixels.ndim == 2 else pixels.mean(axis=2)
    if np.ptp(pixels) < CONTRAST_MIN:
        table.fail(
            key,
            f"{named}has one grey value everywhere ({pixels.flat[0]:.3f})",
            "nothing can be seen in it: is it the right file?",
        )
    return pixels


def _from_skimage(table: Table, key: str, value: str) -> np.ndarray:
    from skimage import data

    name = value.removeprefix("skimage:")
    if name not in data.__all__:
        table.fail(key, f"scikit-image has no picture {name!r}", f"try skimage:rocket{suggest(name, data.__all__)}")
    try:
        pixels = getattr(data, name)()
    except Exception as problem:  # it downloads what it does not ship, by an optional package
        table.fail(
            key,
            f"scikit-image cannot give {name!r} ({problem})",
            "choose one that ships with it, like skimage:rocket",
        )
    if not isinstance(pixels, np.ndarray):
        table.fail(key, f"scikit-image's {name!r} is not a picture", "try skimage:rocket")
    return pixels


def _from_file(table: Table, key: str, value: str, base: Path) -> np.ndarray:
    expanded = os.path.expandvars(os.path.expanduser(value))
    if "$" in expanded:
        table.fail(key, f"{value!r} names an environment variable that is not set", "set it, or write the path out")
    path = base / expanded
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        near = suggest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
        table.fail(key, f"{str(path)!r} {what}", f"paths are relative to the scene file{near}")
    if path.stat().st_size == 0:
        table.fail(key, f"{str(path)!r} is empty (0 bytes)", "copy it again")
    try:
        if path.suffix.lower() == ".npy":
            pixels = np.load(path, mmap_mode="r", allow_pickle=False)
            _check_size(table, key, pixels.shape)
            return np.asarray(pixels)
        return _by_pillow(table, key, path)
    except SceneError:
        raise
    except (OSError, SyntaxError, ValueError) as problem:  # what Pillow and numpy raise at broken files
        _not_an_image(table, key, path, problem)


def _not_an_image(table: Table, key: str, path: Path, problem: Exception) -> NoReturn:
    reason = str(problem).split("\n")[0]
    table.fail(
        key,
        f"{str(path)!r} is not an image that can be read ({reason})",
        "give a whole JPEG, PNG, TIFF, WebP or .npy file",
    )


def _by_pillow(table: Table, key: str, path: Path) -> np.ndarray:
    from PIL import Image, ImageOps, UnidentifiedImageError

    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # ours says how large the image is
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # doubtful EXIF data
            with Image.open(path) as image:
                _check_size(table, key, (image.height, image.width))
                image = ImageOps.exif_transpose(image)
                if image.mode in ("P", "PA") or "transparency" in image.info:
                    image = image.convert("RGBA" if image.mode == "PA" or "transparency" in image.info else "RGB")
                elif image.mode in ("CMYK", "YCbCr", "LAB", "HSV", "RGBX"):
                    image = image.convert("RGB")
                elif image.mode in ("1", "La", "RGBa"):
                    image = image.convert({"1": "L", "La": "LA", "RGBa": "RGBA"}[image.mode])
                return np.asarray(image)
    except UnidentifiedImageError:
        if path.suffix.lower() not in (".tif", ".tiff") or importlib.util.find_spec("tifffile") is None:
            raise
        return _by_tifffile(table, key, path)
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _by_tifffile(table: Table, key: str, path: Path) -> np.ndarray:
    """Colour TIFF of floats or of 16 bits, which Pillow does not know."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            _check_size(table, key, file.pages[0].shape)
            return file.pages[0].asarray()
    except (tifffile.TiffFileError, IndexError) as problem:
        raise ValueError(problem) from problem


def _check_size(table: Table, key: str, shape: tuple[int, ...]) -> None:
    height, width = (*shape, 0, 0)[:2]
    if height * width > MEGAPIXELS_MAX * 1e6:
        table.fail(
            key,
            f"the image has {width} x {height} pixels, {height * width / 1e6:.0f} megapixels",
            f"at most {MEGAPIXELS_MAX} are allowed; scale it down: 1000 pixels along the object are plenty",
        )


def _unit(table: Table, key: str, named: str, pixels: np.ndarray) -> np.ndarray:
    """Any array of pixels as float32 in [0, 1], shape (H, W) or (H, W, 3)."""
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    layers = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.ndim not in (2, 3) or layers > 4:
        table.fail(key, f"{named}has shape {pixels.shape}", "give rows x columns, with 1 to 4 channels last")
    _check_size(table, key, pixels.shape)
    if pixels.size == 0:
        table.fail(key, f"{named}is empty (shape {pixels.shape})", "give an image with pixels")
    if min(pixels.shape[:2]) < SIDE_MIN:
        table.fail(
            key,
            f"{named}is only {pixels.shape[1]} x {pixels.shape[0]} pixels",
            f"each side must have at least {SIDE_MIN}",
        )
    unit = _scaled(table, key, named, pixels)
    if layers in (2, 4):
        alpha = unit[..., -1:]
        unit = unit[..., :-1] * alpha + BACKGROUND * (1 - alpha)
    return np.ascontiguousarray(unit[..., 0] if layers == 2 else unit)


def _scaled(table: Table, key: str, named: str, pixels: np.ndarray) -> np.ndarray:
    kind = pixels.dtype
    if np.issubdtype(kind, np.bool_):
        return pixels.astype(np.float32)
    if kind in (np.uint8, np.uint16):
        return pixels.astype(np.float32) / np.float32(np.iinfo(kind).max)
    if not (np.issubdtype(kind, np.floating) or np.issubdtype(kind, np.integer)):
        table.fail(key, f"{named}holds {kind}", "give whole numbers of 8 or 16 bits, or floats in [0, 1]")
    if not np.isfinite(pixels).all():
        bad = np.argwhere(~np.isfinite(pixels))
        table.fail(
            key,
            f"{named}holds {len(bad)} values NaN or infinite, first at column {bad[0][1]}, row {bad[0][0]}",
            "fill them, and hide the place with view.ignore",
        )
    low, high = float(pixels.min()), float(pixels.max())
    if np.issubdtype(kind, np.integer):  # 16 bits in a wider kind, as some files have them
        if low < 0 or high > 65535:
            table.fail(key, f"{named}has whole numbers from {low:g} to {high:g}", "give 8 or 16 bits without sign")
        return (pixels / (255.0 if high < 256 else 65535.0)).astype(np.float32)
    if low < -1e-3 or high > 1 + 1e-3:
        table.fail(key, f"{named}has floats from {low:g} to {high:g}", "scale them into [0, 1], 8-bit values by 255")
    return pixels.clip(0, 1).astype(np.float32)
