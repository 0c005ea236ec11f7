"""MP4 files that play everywhere: H.264, yuv420p, even sizes, index first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np
from av.container import OutputContainer
from av.video.reformatter import (
    ColorPrimaries,
    ColorRange,
    Colorspace,
    ColorTrc,
    Interpolation,
    VideoReformatter,
)
from av.video.stream import VideoStream

from .files import whole_file


def write_mp4(path: str | Path, frames: Iterable[np.ndarray], fps: float = 25, crf: int = 20) -> int:
    """Encode frames one by one and return their number; the file appears when it is whole, or not at all.

    Args:
        path: name of the file, ".mp4".
        frames: images of one size, shape (H, W, 3), uint8 RGB; an odd last row or column is repeated.
            A generator is closed in any case.
        fps: frames per second.
        crf: x264's constant rate factor; lower is better and larger.

    Raises:
        ValueError: there is no frame, or a frame is not uint8 RGB or not of the first one's size.
    """
    source = iter(frames)
    try:
        with whole_file(path) as part:
            return _encode(part, source, fps, crf)
    finally:
        close = getattr(source, "close", None)
        if close is not None:
            close()


def _encode(path: Path, frames: Iterator[np.ndarray], fps: float, crf: int) -> int:
    first = next(frames, None)
    if first is None:
        raise ValueError("a video needs at least one frame")
    count, converter = 0, VideoReformatter()
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = _stream(container, first.shape, fps, crf)
        for count, frame in enumerate(chain([first], frames), start=1):
            if frame.dtype != np.uint8 or frame.shape != (*first.shape[:2], 3):
                raise ValueError(f"frame {count}: need uint8 {(*first.shape[:2], 3)}, got {frame.dtype} {frame.shape}")
            container.mux(stream.encode(_picture(frame, converter)))
        container.mux(stream.encode())
    return count


def _stream(container: OutputContainer, shape: tuple[int, ...], fps: float, crf: int) -> VideoStream:
    options = {"crf": str(crf), "preset": "veryfast"}
    stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001), options=options)
    stream.height, stream.width = shape[0] + shape[0] % 2, shape[1] + shape[1] % 2
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.colorspace = Colorspace.ITU709
    context.color_range = ColorRange.MPEG
    context.color_primaries = ColorPrimaries.BT709
    context.color_trc = ColorTrc.BT709
    return stream


def _picture(frame: np.ndarray, converter: VideoReformatter) -> av.VideoFrame:
    height, width = frame.shape[:2]
    if height % 2 or width % 2:
        frame = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
    # untagged colours are BT.601 to one player and BT.709 to the next: convert and tag
    return converter.reformat(
        picture,
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation=Interpolation.BILINEAR,  # the size stays: same bytes as bicubic, half the time
    )
