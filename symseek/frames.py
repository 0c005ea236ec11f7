"""Frames of moving scenes, one at a time: from a video, from files by a pattern or in a folder, or from arrays."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import zip_longest
from pathlib import Path

import numpy as np

from . import images
from .checks import SceneError, Table, shown, suggest
from .sim.lens import Lens

VIDEOS = {".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg"}
PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".npy", ".bmp"}


class Frames:
    """The frames of one view; iterating reads them anew, each a float32 image in [0, 1] or a text that says why not.

    Attributes:
        fps: frames a second, of a video; else None.
        lens: what bends them, if anything; they come out straight.
        crops: whether each is cut out about the object, of a size of its own; its first pixel is the origin.

    Args:
        table: the [[view]] table.
        base: folder that paths are relative to.

    Raises:
        SceneError: nothing there, or the first frame cannot be read.
    """

    def __init__(self, table: Table, base: Path):
        value = table.take("frames")
        self._table, self._base = table, base
        self._video: Path | None = None
        self._files: Sequence[Path | np.ndarray] = []
        self.fps: float | None = None
        self.lens: Lens | None = None
        self.crops = table.flag("crops", False)
        if isinstance(value, os.PathLike):
            value = os.fspath(value)
        if isinstance(value, list | tuple | np.ndarray):
            self._files = [f if isinstance(f, np.ndarray) else base / str(f) for f in value]
        elif not isinstance(value, str) or not value.strip():
            table.fail("frames", f"{shown(value)} is not a path", 'write it in quotes, like "left.mp4" or "left_*.png"')
        else:
            self._find(base / os.path.expandvars(os.path.expanduser(value)))
        if not len(self._files) and self._video is None:
            table.fail("frames", f"{shown(value)} names no picture", "give a video, a folder, or a pattern like left_*.png")
        first = next(iter(self), "it is empty")
        if isinstance(first, str):
            table.fail("frames", f"the first frame cannot be read: {first}", "give a whole video, or whole pictures")
        self.first = first

    def _find(self, path: Path) -> None:
        if path.is_dir():
            self._files = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURES)
        elif path.suffix.lower() in VIDEOS:
            if not path.is_file():
                near = suggest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
                self._table.fail("frames", f"{str(path)!r} does not exist", f"paths are relative to the scene file{near}")
            self._video = path
        else:
            self._files = sorted(path.parent.glob(path.name)) if path.parent.is_dir() else []

    def straighten(self, lens: Lens) -> None:
        """From now on frames come out as without this lens."""
        self.lens, self.first = lens, lens.image(self.first)

    def __len__(self) -> int:
        """How many there are; of a video, how many pictures it holds, not all of which need be whole."""
        return len(self._files) if self._video is None else len(self._times)

    @cached_property
    def _times(self) -> list[int]:
        """When each picture of the video is shown, in its own unit."""
        import av

        with av.open(str(self._video)) as container:
            return sorted(packet.pts for packet in container.demux(video=0) if packet.pts is not None)

    def __iter__(self) -> Iterator[np.ndarray | str]:
        return self.since(0)

    def since(self, start: int) -> Iterator[np.ndarray | str]:
        """The frames from number `start` on, without reading all those before it."""
        for frame in self._read(start):
            bent = self.lens is not None and isinstance(frame, np.ndarray) and frame.shape[1::-1] == self.lens.size
            yield self.lens.image(frame) if bent else frame  # pyright: ignore

    def _read(self, start: int) -> Iterator[np.ndarray | str]:
        if self._video is not None:
            yield from self._decoded(self._video, start)
            return
        for file in self._files[start:]:
            value = file if isinstance(file, np.ndarray) else str(file)
            single = Table({"frames": value}, self._table.source, "view", ["frames"])
            try:
                yield images.read(single, "frames", Path())
            except SceneError as problem:
                yield str(problem)

    def _decoded(self, path: Path, start: int) -> Iterator[np.ndarray | str]:
        import av
        from av.error import FFmpegError

        try:
            with av.open(str(path)) as container:
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                self.fps = float(stream.average_rate) if stream.average_rate else None
                first = None
                if start > 0:
                    first = self._times[start] if start < len(self._times) else math.inf
                    container.seek(self._times[min(start, len(self._times) - 1)], stream=stream)
                for frame in container.decode(stream):
                    if first is not None and (frame.pts is None or frame.pts < first):
                        continue
                    yield frame.to_ndarray(format="rgb24").astype(np.float32) / np.float32(255)
        except (FFmpegError, IndexError) as problem:
            yield f"{path.name}: {problem}"


def together(sources: Sequence[Frames]) -> Iterator[list[np.ndarray] | str]:
    """Frames of all views at a time, or why there is none; as many as the shortest view has."""
    size = [source.first.shape[:2] for source in sources]
    for pictures in zip_longest(*sources):
        if any(picture is None for picture in pictures):
            return
        bad = [p for p in pictures if isinstance(p, str)]
        good = [p for p in pictures if isinstance(p, np.ndarray)]
        if not bad and any(p.shape[:2] != s and not f.crops for p, s, f in zip(good, size, sources, strict=True)):
            bad = ["it has another size than the first; is it a tracker's crop (crops = true)?"]
        yield f"skipped: {bad[0]}" if bad else good
