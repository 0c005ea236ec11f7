"""Figures: the solids of several tubes united into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np

from .problem import Tube
from .result import ObjectResult


@dataclass(frozen=True)
class Figure:
    """The solids of several tubes united."""

    name: str
    tubes: list[str]
    """their names."""
    vertices: np.ndarray
    """shape (V, 3), world units."""
    faces: np.ndarray
    """shape (F, 3), outward."""
    volume: float
    area: float
    pieces: list[list[int]]
    """which of the tubes hang together, largest piece first; one piece where all do."""

    @property
    def warnings(self) -> list[str]:
        """What keeps it from being one solid."""
        apart = [" and ".join(self.tubes[k] for k in piece) for piece in self.pieces[1:]]
        remedy = "draw its axis further into the neighbour, or mend its depth"
        return [f"{names} does not touch the rest: {remedy}" for names in apart]


def figures(tubes: Sequence[Tube], objects: Sequence[ObjectResult]) -> list[Figure]:
    """The figures that tubes name, in the order in which they are first named.

    Raises:
        ValueError: a tube's surface is not closed.
    """
    found = []
    for name in dict.fromkeys(tube.figure for tube in tubes if tube.figure):
        parts = [o for tube, o in zip(tubes, objects, strict=True) if tube.figure == name]
        found.append(unite(name, [o.name for o in parts], [(o.vertices, o.faces) for o in parts]))
    return found


def unite(name: str, tubes: list[str], meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> Figure:
    """The union of closed surfaces; watertight, in pieces where they do not touch.

    Args:
        name: of the figure.
        tubes: names of the surfaces.
        meshes: (vertices (V, 3), faces (F, 3) outward) each, watertight.

    Raises:
        ValueError: a mesh is not closed, or not finite.
    """
    solids = []
    for k, (vertices, faces) in enumerate(meshes):
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
        )
        if solid.status() != manifold3d.Error.NoError:
            raise ValueError(f"{tubes[k]} is no closed surface: {solid.status().name}")
        solids.append(solid)
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    mesh = whole.to_mesh64()
    return Figure(
        name,
        tubes,
        np.asarray(mesh.vert_properties)[:, :3].copy(),
        np.asarray(mesh.tri_verts).astype(np.int64),
        float(whole.volume()),
        float(whole.surface_area()),
        [list(range(len(solids)))] if len(whole.decompose()) == 1 else _pieces(solids),
    )


def _pieces(solids: list[manifold3d.Manifold]) -> list[list[int]]:
    """Which solids hang together: they share some volume, directly or by others."""
    groups: list[list[int]] = []
    for k, solid in enumerate(solids):
        met = [g for g in groups if any(_overlap(solid, solids[j]) for j in g)]
        groups = [g for g in groups if g not in met] + [sorted(sum(met, [k]))]
    return sorted(groups, key=lambda g: (-sum(solids[k].volume() for k in g), g))


def _overlap(one: manifold3d.Manifold, other: manifold3d.Manifold) -> bool:
    low, high = (np.array(box).reshape(2, 3) for box in (one.bounding_box(), other.bounding_box()))
    apart = np.any(low[1] < high[0]) or np.any(high[1] < low[0])
    return not apart and (one ^ other).volume() > 0
