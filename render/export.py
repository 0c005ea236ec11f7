"""Meshes as files: PLY in world units for computing, GLB in metres for viewers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from .files import whole_file
from .lighting import vertex_normals

FRAME = "X right, Y down, Z away from the viewer"
WORLD_TO_GLTF = np.array([1.0, -1.0, -1.0])  # half a turn about X: Y up, +Z toward the viewer


def write_ply(path: str | Path, vertices: np.ndarray, faces: np.ndarray, units: str = "px", frame: str = FRAME) -> None:
    """Write a binary little-endian PLY with vertex normals; units and frame stand in its comments.

    Args:
        path: name of the file.
        vertices: shape (V, 3), world units, any float type; written as float32.
        faces: shape (F, 3), counter-clockwise seen from outside.
        units: of the world, "px" or "mm" and the like.
        frame: the directions of the axes, in words.

    Raises:
        ValueError: the faces name vertices that are not there.
    """
    vertices, faces = checked(vertices, faces)
    names = ("x", "y", "z", "nx", "ny", "nz")
    points = np.empty(len(vertices), [(name, "<f4") for name in names])
    columns = np.hstack([vertices, vertex_normals(vertices, faces)]).T
    for name, values in zip(names, columns, strict=True):
        points[name] = values
    triangles = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment made by symseek",
        f"comment units: {units}",
        f"comment frame: {frame}",
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in names),
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with whole_file(path) as part:
        head = "\n".join([*header, ""]).encode("ascii", "replace")
        part.write_bytes(head + points.tobytes() + triangles.tobytes())


def write_glb(
    path: str | Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    metres_per_unit: float,
    colour: tuple[int, int, int] = (217, 140, 74),
    name: str = "object",
) -> None:
    """Write a GLB with vertex normals and a plain material, in metres, Y up, +Z toward the viewer.

    Args:
        path: name of the file.
        vertices: shape (V, 3), world units, in the frame X right, Y down, Z away.
        faces: shape (F, 3), counter-clockwise seen from outside; half a turn leaves that so.
        metres_per_unit: length of a world unit, m.
        colour: sRGB, 0 to 255.
        name: of the node and its mesh.

    Raises:
        ValueError: the faces name vertices that are not there, or metres_per_unit is not positive.
    """
    if not metres_per_unit > 0:
        raise ValueError(f"metres_per_unit must be positive, not {metres_per_unit}")
    vertices, faces = checked(vertices, faces)
    mesh = trimesh.Trimesh(
        vertices=vertices * WORLD_TO_GLTF * metres_per_unit,
        faces=faces,
        vertex_normals=vertex_normals(vertices, faces) * WORLD_TO_GLTF,
        process=False,
    )
    linear = (np.asarray(colour) / 255.0) ** 2.2  # glTF's factors are linear
    material = PBRMaterial(name=name, baseColorFactor=[*linear, 1.0], metallicFactor=0.0, roughnessFactor=0.55)
    mesh.visual = TextureVisuals(material=material)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name=name, geom_name=name)
    with whole_file(path) as part:
        part.write_bytes(export_glb(scene, include_normals=True))


def checked(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces as float and int; ValueError where faces name vertices that are not there."""
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, int)
    if faces.size and not (0 <= faces.min() and faces.max() < len(vertices)):
        raise ValueError(f"faces name vertices {faces.min()} to {faces.max()} of {len(vertices)}")
    return vertices, faces
