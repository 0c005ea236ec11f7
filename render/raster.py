"""Shaded frames of meshes, drawn off screen by pyrender."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .lighting import backdrop, lit, vertex_normals
from .lines import Colour, Pen, Polylines, stroke
from .offscreen import Box, Surface
from .platform import RenderError

Meshes = Sequence[tuple[np.ndarray, np.ndarray, Colour]]
"""(vertices (V, 3) world units, faces (F, 3) outward, sRGB colour), one for each object."""

_TO_GL = np.array([1.0, -1.0, -1.0])  # OpenGL looks along -z with y up


@dataclass(frozen=True)
class Viewpoint:
    """An orthographic look at a fixed sphere, so that the framing never changes within a clip."""

    centre: np.ndarray
    """of the sphere, shape (3,), world units."""
    radius: float
    """of the sphere, world units."""
    azimuth: float = 0.0
    """degrees the viewer has walked around the vertical toward the object's right; 90 sees its right side."""
    elevation: float = 0.0
    """degrees above the horizontal; 90 looks straight down."""
    front: np.ndarray = field(default_factory=lambda: np.eye(3))
    """rotation from the world to the frame (right, down, away) of azimuth and elevation 0, shape (3, 3)."""
    margin: float = 1.08
    """half the shorter side of the picture, in radii."""

    @property
    def rotation(self) -> np.ndarray:
        """World to (right, down, away), shape (3, 3)."""
        a, e = np.radians([self.azimuth, self.elevation])
        around = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        above = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return above @ around @ self.front

    def look(self, points: np.ndarray) -> np.ndarray:
        """World points, shape (n, 3), as (right, down, away) in radii from the centre, shape (n, 3)."""
        return (np.asarray(points, float) - self.centre) @ (self.rotation / self.radius).T

    def project(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """World points, shape (n, 3), as (column, row) of a picture, shape (n, 2)."""
        scale = min(width, height) / 2 / self.margin
        return self.look(points)[:, :2] * scale + (np.array([width, height]) - 1) / 2


def bounding_sphere(*vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre, shape (3,), of the box around points, each of shape (n, 3), and the radius that holds them."""
    points = np.concatenate([np.asarray(part, float).reshape(-1, 3) for part in vertices])
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, max(float(np.linalg.norm(points - centre, axis=1).max()), 1e-12)


class Renderer:
    """Draws pictures of one size; a context manager, and only one may be open in a process.

    Args:
        width, height: px.
        supersample: pixels drawn along each side of a pixel, against jagged edges.

    Raises:
        RenderError: no OpenGL context can be had, or another Renderer is open.
    """

    _one = threading.Lock()

    def __init__(self, width: int, height: int, supersample: int = 2):
        self.width, self.height, self.supersample = width, height, supersample
        if not Renderer._one.acquire(blocking=False):
            raise RenderError("another Renderer is open in this process", "Close it first.")
        try:
            self._surface = Surface(width * supersample, height * supersample)
        except BaseException:
            Renderer._one.release()
            raise
        self._closed = False
        self._backdrop = backdrop(width, height)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context; a second call does nothing."""
        if not self._closed:
            self._closed = True
            try:
                self._surface.close()
            finally:
                Renderer._one.release()

    def identity(self) -> tuple[str, str]:
        """GL_VENDOR and GL_RENDERER."""
        return self._surface.identity()

    def shade(
        self,
        meshes: Meshes,
        viewpoint: Viewpoint,
        lines: Polylines = (),
        line_colour: Colour = (255, 255, 255),
        line_width: float = 1.2,
    ) -> np.ndarray:
        """A picture of the meshes before the backdrop, shape (H, W, 3), uint8.

        Args:
            meshes: (vertices, faces, colour) each.
            viewpoint: where the viewer stands.
            lines: polylines in the world, shape (n, 3) each, drawn on top where no surface hides them.
            line_colour: sRGB.
            line_width: px.

        Raises:
            ValueError: a vertex is not finite.
        """
        layer, (left, top, right, bottom) = self._layer(meshes, viewpoint)
        picture = self._backdrop.copy()
        _lay(layer, picture[top:bottom, left:right])
        if len(lines):
            depth = self._surface.depth()
            seen = [part for line in lines for part in self._unhidden(line, viewpoint, depth)]
            stroke(picture, seen, Pen(line_colour, line_width, 0.85))
        return picture

    def wires(self, meshes: Meshes, viewpoint: Viewpoint, wires: Sequence[Polylines], paper: Colour) -> np.ndarray:
        """Wire frames on paper, shape (H, W, 3), uint8, each in its mesh's colour and hidden where any mesh hides it.

        Args:
            meshes: (vertices, faces, colour) each.
            viewpoint: where the viewer stands.
            wires: of each mesh, polylines in the world, shape (n, 3) each.
            paper: sRGB of the ground.
        """
        self._layer(meshes, viewpoint)
        depth = self._surface.depth()
        picture = np.full((self.height, self.width, 3), paper, np.uint8)
        for lines, (_, _, colour) in zip(wires, meshes, strict=True):
            seen = [part for line in lines for part in self._unhidden(line, viewpoint, depth)]
            stroke(picture, seen, Pen(colour, 0.8))
        return picture

    def alpha(self, meshes: Meshes, viewpoint: Viewpoint) -> np.ndarray:
        """Share of each pixel that the meshes cover, shape (H, W), float32 in [0, 1]."""
        layer, (left, top, right, bottom) = self._layer(meshes, viewpoint)
        alpha = np.zeros((self.height, self.width), np.float32)
        alpha[top:bottom, left:right] = layer[..., 3] / np.float32(255)
        return alpha

    def _layer(self, meshes: Meshes, viewpoint: Viewpoint) -> tuple[np.ndarray, Box]:
        """Colours premultiplied by coverage, shape (h, w, 4), uint8, and their box in the picture."""
        # merged: each node costs milliseconds
        starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in meshes)])
        world = np.concatenate([np.asarray(vertices, float) for vertices, _, _ in meshes])
        triangles = np.concatenate(
            [np.asarray(faces, np.int64) + start for (_, faces, _), start in zip(meshes, starts, strict=False)]
        )
        colours = np.repeat([colour for _, _, colour in meshes], np.diff(starts), axis=0)
        if not np.isfinite(world).all():
            raise ValueError("a mesh has vertices that are not finite")
        seen = viewpoint.look(world) * _TO_GL
        factor, box = self.supersample, self._box(viewpoint.project(world, self.width, self.height))
        fine = self._surface.draw(
            seen,
            lit(vertex_normals(seen, triangles), colours),
            triangles,
            viewpoint.margin,
            (box[0] * factor, box[1] * factor, box[2] * factor, box[3] * factor),
        )
        return _reduced(fine, factor), box

    def _box(self, points: np.ndarray) -> Box:
        """The pixels that hold these points (column, row), shape (n, 2); at least one."""
        size = np.array([self.width, self.height])
        low = np.clip(np.floor(points.min(axis=0)), 0, size - 1).astype(int)
        high = np.clip(np.ceil(points.max(axis=0)) + 1, low + 1, size).astype(int)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def _unhidden(self, line: np.ndarray, viewpoint: Viewpoint, depth: np.ndarray) -> list[np.ndarray]:
        """The parts of a world polyline before the surface, as polylines in the picture."""
        fine = _densified(np.asarray(line, float), viewpoint.radius / 150)
        size = np.array([self.width, self.height]) * self.supersample
        pixel = viewpoint.project(fine, *size)
        ahead = _furthest(depth, pixel) - viewpoint.look(fine)[:, 2]
        runs = np.flatnonzero(np.diff(np.concatenate([[False], ahead > -0.012, [False]]).astype(np.int8)))
        # a supersampled point p lies at (p + 1/2) / s - 1/2 of the picture
        picture = (pixel + 0.5) / self.supersample - 0.5
        return [picture[first:last] for first, last in zip(runs[::2], runs[1::2], strict=True)]


def _furthest(depth: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Largest depth within a pixel of each point (column, row), so that lines on the very rim stay."""
    height, width = depth.shape
    column = np.clip(np.rint(points[:, 0]).astype(int), 1, width - 2)
    row = np.clip(np.rint(points[:, 1]).astype(int), 1, height - 2)
    return np.max([depth[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)


def _densified(line: np.ndarray, step: float) -> np.ndarray:
    """A polyline, shape (n, 3), with extra points so that none are further apart than `step`."""
    count = np.maximum(np.ceil(np.linalg.norm(np.diff(line, axis=0), axis=1) / step), 1).astype(int)
    knots = np.concatenate([[0], np.cumsum(count)])
    return np.column_stack([np.interp(np.arange(knots[-1] + 1), knots, line[:, axis]) for axis in range(3)])


def _reduced(fine: np.ndarray, factor: int) -> np.ndarray:
    """Means of factor x factor pixels, shape (H, W, 4) to (H / factor, W / factor, 4), uint8."""
    height, width = fine.shape[0] // factor, fine.shape[1] // factor
    rows = fine[::factor].astype(np.uint16, order="C")
    for row in range(1, factor):
        rows += fine[row::factor]
    # the four 16-bit sums of a pixel are added as one 64-bit word: none reaches the next
    words = rows.view(np.uint64)[..., 0]
    total = np.zeros((height, width), np.uint64)
    for column in range(factor):
        total += words[:, column::factor]
    means = (total[..., None].view(np.uint16) + factor**2 // 2) // factor**2
    return means.astype(np.uint8)


def _lay(layer: np.ndarray, picture: np.ndarray) -> None:
    """Lay premultiplied colours, shape (h, w, 4), over a picture, shape (h, w, 3), in place; all uint8."""
    alpha = layer[..., 3]
    whole = alpha == 255
    for channel in range(3):
        np.copyto(picture[..., channel], layer[..., channel], where=whole)
    rim = np.nonzero((alpha > 0) & ~whole)  # few: the arithmetic is spared the rest
    clear = 255 - alpha[rim][:, None].astype(np.uint16)
    picture[rim] = layer[rim][:, :3] + ((picture[rim] * clear + 127) // 255).astype(np.uint8)
