"""The depth pass: which of many surfaces is nearest at each pixel of a view, and how far it is, by pyrender off screen."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

import numpy as np

from .offscreen import Surface
from .platform import RenderError

__all__ = ["DepthPass", "RenderError"]

REACH = 2.9
"""Depths are drawn between minus this and this, just inside the near and far planes."""
GRAIN = 64
"""Surfaces are as large as the next multiple of this, so that few are made [px]."""


class DepthPass:
    """Draws all surfaces as one primitive and reads depth and owner back; with no growth of memory.

    Vertices come as seen by the view, (column, row, depth): any camera will do, and depth is interpolated as it is given.

    Raises:
        RenderError: no OpenGL context can be had.
    """

    def __init__(self) -> None:
        self._surface: Surface | None = None

    def __enter__(self) -> DepthPass:
        return self

    def __exit__(self, kind: type | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Frees the context."""
        if self._surface is not None:
            self._surface.close()
            self._surface = None

    def __call__(
        self, meshes: Sequence[tuple[np.ndarray, np.ndarray]], shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depth and owner at each pixel's centre.

        Args:
            meshes: vertices (V, 3) as seen, (column, row, depth), and faces (F, 3), which are drawn from both sides.
            shape: height and width of the picture.

        Returns:
            depth of the nearest surface, shape (H, W), infinite where there is none; number of its mesh, -1 for none.
        """
        height, width = shape
        surface = self._of_size(width, height)
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
        points = np.concatenate([vertices for vertices, _ in meshes])
        faces = np.concatenate([f + start for (_, f), start in zip(meshes, starts, strict=False)])
        near, far = points[:, 2].min(), points[:, 2].max()
        middle, span = (near + far) / 2, max((far - near) / 2, 1e-12) / REACH
        # a surface larger than the picture looks a little further right and down
        half = np.array([surface.width, surface.height]) / 2
        placed = np.column_stack([(points[:, :2] + 0.5 - half) / half[1], (points[:, 2] - middle) / span])
        owner = np.repeat(np.arange(1, len(meshes) + 1), [len(vertices) for vertices, _ in meshes])
        coded = np.stack([owner >> 16 & 255, owner >> 8 & 255, owner & 255], axis=1) / 255.0
        box = (0, 0, width, height)
        reach = float(min(half) / half[1])
        drawn = surface.draw(placed * [1, -1, -1], coded, faces, reach, box, culled=False).astype(np.int64)
        number = (drawn[..., 0] << 16) + (drawn[..., 1] << 8) + drawn[..., 2] - 1
        depth = surface.depth()[:height, :width] * span + middle
        return np.where(number < 0, np.inf, depth), number

    def _of_size(self, width: int, height: int) -> Surface:
        """The surface, made anew when it is too small."""
        held = self._surface
        if held is None or held.width < width or held.height < height:
            size = [width, height] if held is None else [max(width, held.width), max(height, held.height)]
            self.close()
            self._surface = Surface(*(-(-s // GRAIN) * GRAIN for s in size))
        assert self._surface is not None
        return self._surface
