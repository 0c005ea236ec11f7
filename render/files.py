"""Files that are whole or absent."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; it becomes `path` at the end, or vanishes on an error or ^C."""
    path = Path(path)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_picture(path: str | Path, image: np.ndarray) -> None:
    """Write an image, shape (H, W, 3) or (H, W), uint8, in the format of the name's ending."""
    with whole_file(path) as part:
        Image.fromarray(np.ascontiguousarray(image)).save(part, compress_level=4)
