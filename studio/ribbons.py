"""Lines on the photograph as flat strips, those of one colour in one mesh.

Without a graphics card a browser draws each segment of a line node by itself, and many of them take most of a frame; a mesh
it draws at once, and one that keeps its size it need not make anew.
"""

from __future__ import annotations

import numpy as np
import viser

LEAST = 64
"""Segments that a mesh has room for."""
OVERLAP = 0.3
"""How far a strip goes on beyond its segment, so that the next one meets it [its width]."""


class Ribbons:
    """Lines of one thickness.

    Args:
        scene: of the viser server.
        name: of its nodes.
        thickness: [screen px].
    """

    def __init__(self, scene: viser.SceneApi, name: str, thickness: float):
        self._scene, self._name, self._thickness = scene, name, thickness
        self._meshes: dict[int, viser.MeshHandle] = {}

    def show(self, segments: np.ndarray, colours: np.ndarray, depth: float, pixel: float) -> None:
        """Shows these and no others.

        Args:
            segments: (n, 2, 2) in the photograph; those that are not finite are left out.
            colours: (n, 3) or (3,), 0 to 255.
            depth: of the plane that they lie in.
            pixel: what a pixel of the screen is of the photograph's.
        """
        good = np.isfinite(segments).all(axis=(1, 2))
        kinds = np.broadcast_to(np.rint(colours).astype(int) @ [1 << 16, 1 << 8, 1], len(segments))[good]
        strips = strips_of(segments[good], self._thickness * pixel)
        for colour, mesh in self._meshes.items():
            mesh.visible = bool((kinds == colour).any())
        for colour in np.unique(kinds):
            self._fill(int(colour), strips[kinds == colour], depth)

    def _fill(self, colour: int, strips: np.ndarray, depth: float) -> None:
        """One mesh; what it has room for beyond its strips lies in a point."""
        mesh = self._meshes.get(colour)
        room = LEAST if mesh is None else len(mesh.vertices) // 4
        while room < len(strips):
            room *= 2
        vertices = np.full((room, 4, 3), depth, np.float32)
        vertices[: len(strips), :, :2] = strips
        vertices[len(strips) :, :, :2] = strips[-1, -1]
        vertices = vertices.reshape(-1, 3)
        if mesh is not None and len(mesh.vertices) == len(vertices):
            mesh.vertices = vertices
            return
        faces = 4 * np.arange(room, dtype=np.uint32)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        rgb = (colour >> 16, colour >> 8 & 255, colour & 255)
        self._meshes[colour] = self._scene.add_mesh_simple(
            f"/drawn/{self._name}/{colour:06x}", vertices, faces.reshape(-1, 3), color=rgb, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip


def strips_of(segments: np.ndarray, width: float) -> np.ndarray:
    """Corners in turn, shape (n, 4, 2), of strips along segments (n, 2, 2)."""
    way = segments[:, 1] - segments[:, 0]
    way = 0.5 * width * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    across, on = np.stack([-way[:, 1], way[:, 0]], axis=1), 2 * OVERLAP * way
    a, b = segments[:, 0] - on, segments[:, 1] + on
    return np.stack([a - across, a + across, b + across, b - across], axis=1)
