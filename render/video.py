"""MP4 files that play everywhere: H.264, yuv420p, even sizes, index first."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

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
        with whole_file(path) as part, closing(_Encoder(part, fps, crf)) as encoder:
            for frame in source:
                encoder.add(frame)
            encoder.finish()
    finally:
        if hasattr(source, "close"):
            source.close()
    return encoder.count


class _Encoder:
    """One H.264 stream in an MP4 container; made when the first frame tells the size."""

    def __init__(self, path: Path, fps: float, crf: int):
        self.count = 0
        self._path, self._fps, self._crf = path, Fraction(fps).limit_denominator(1001), crf
        self._container: av.container.OutputContainer | None = None

    def add(self, frame: np.ndarray) -> None:
        frame = np.asarray(frame)
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(f"frame {self.count}: need uint8 (H, W, 3), got {frame.dtype} {frame.shape}")
        if self._container is None:
            self._open(frame.shape)
        if frame.shape != self._shape:
            raise ValueError(f"frame {self.count} is {frame.shape}, the first one was {self._shape}")
        height, width = frame.shape[:2]
        even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge") if (height | width) & 1 else frame
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        # players take untagged video for BT.709 or BT.601 as they please: convert and tag
        picture = picture.reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
        )
        self._container.mux(self._stream.encode(picture))
        self.count += 1

    def finish(self) -> None:
        if self._container is None:
            raise ValueError("a video needs at least one frame")
        self._container.mux(self._stream.encode())

    def close(self) -> None:
        if self._container is not None:
            self._container.close()

    def _open(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._container = av.open(str(self._path), "w", format="mp4", options={"movflags": "+faststart"})
        stream = self._container.add_stream("libx264", rate=self._fps)
        stream.height, stream.width = shape[0] + shape[0] % 2, shape[1] + shape[1] % 2
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": str(self._crf), "preset": "veryfast"}
        context = stream.codec_context
        context.colorspace = Colorspace.ITU709
        context.color_range = ColorRange.MPEG
        context.color_primaries = ColorPrimaries.BT709
        context.color_trc = ColorTrc.BT709
        self._stream = stream
