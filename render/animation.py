"""Meshes that move, as files: glTF with morph targets, USD with time samples."""

from __future__ import annotations

import json
import struct
from importlib import import_module
from pathlib import Path

import numpy as np

from .export import WORLD_TO_GLTF, checked
from .files import whole_file
from .lighting import vertex_normals


def write_animated_glb(
    path: str | Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    time: np.ndarray,
    metres_per_unit: float,
    colour: tuple[int, int, int] = (217, 140, 74),
    name: str = "object",
) -> None:
    """Write a GLB in metres, Y up, whose mesh plays through its frames: a morph target each, linear between them.

    Args:
        path: name of the file.
        vertices: of each frame, shape (F, V, 3), world units, in the frame X right, Y down, Z away.
        faces: shape (T, 3), counter-clockwise seen from outside.
        time: of each frame, shape (F,), rising [s].
        metres_per_unit: length of a world unit, m.
        colour: sRGB, 0 to 255.
        name: of node and mesh.

    Raises:
        ValueError: faces name vertices that are not there.
    """
    _, faces = checked(vertices[0], faces)
    points = (vertices * WORLD_TO_GLTF * metres_per_unit).astype(np.float32)
    count = len(points)
    weights = np.eye(count, dtype=np.float32)[:, 1:]  # the first frame is the mesh itself
    blocks: list[tuple[np.ndarray, dict]] = []

    def add(array: np.ndarray, kind: str, target: int | None = None, bounds: bool = False) -> int:
        size = array.reshape(-1, 3) if kind == "VEC3" else array.reshape(-1, 1)
        accessor = {"componentType": 5125 if array.dtype == np.uint32 else 5126, "count": len(size), "type": kind}
        if bounds:
            accessor |= {"min": size.min(axis=0).tolist(), "max": size.max(axis=0).tolist()}
        blocks.append((array, accessor | ({"target": target} if target else {})))
        return len(blocks) - 1

    normals = vertex_normals(vertices[0].astype(float), faces) * WORLD_TO_GLTF
    attributes = {
        "POSITION": add(points[0], "VEC3", 34962, True),
        "NORMAL": add(normals.astype(np.float32), "VEC3", 34962),
    }
    indices = add(faces.astype(np.uint32).ravel(), "SCALAR", 34963)
    targets = [{"POSITION": add(p - points[0], "VEC3", 34962, True)} for p in points[1:]]
    linear = [float((c / 255) ** 2.2) for c in colour]
    mesh = {
        "name": name,
        "primitives": [{"attributes": attributes, "indices": indices, "material": 0, "targets": targets}],
        "weights": [0.0] * (count - 1),
    }
    document = {
        "asset": {"version": "2.0", "generator": "symseek"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "materials": [
            {
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.55,
                },
            }
        ],
        "meshes": [mesh],
    }  # fmt: skip
    if count > 1:
        sampler = {"input": add(time.astype(np.float32), "SCALAR", None, True), "output": add(weights.ravel(), "SCALAR")}
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        document["animations"] = [{"name": "motion", "samplers": [sampler], "channels": [channel]}]
    else:
        del mesh["weights"], mesh["primitives"][0]["targets"]
    binary, views, accessors = b"", [], []
    for array, accessor in blocks:
        target = {"target": accessor.pop("target")} if "target" in accessor else {}
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes, **target})
        accessors.append({"bufferView": len(views) - 1, **accessor})
        binary += np.ascontiguousarray(array).tobytes()
    document |= {"buffers": [{"byteLength": len(binary)}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with whole_file(path) as part:
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        part.write_bytes(head + chunks)


def write_usd(
    path: str | Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    fps: float,
    metres_per_unit: float,
    colour: tuple[int, int, int] = (217, 140, 74),
    name: str = "object",
) -> None:
    """Write a USD file with a time sample for each frame, Y up, in world units with their size in metres.

    Args:
        path: name of the file, .usdc, .usda or .usd.
        vertices, faces: as of `write_animated_glb`.
        fps: time codes a second; frame i lies at time code i.
        metres_per_unit, colour, name: likewise.

    Raises:
        ImportError: usd-core is not installed.
    """
    # an optional package, and without types
    gf, usd, geom, vt = (import_module(f"pxr.{name}") for name in ("Gf", "Usd", "UsdGeom", "Vt"))

    points = (vertices * WORLD_TO_GLTF).astype(np.float32)
    with whole_file(path) as part:
        stage = usd.Stage.CreateNew(str(part))
        geom.SetStageUpAxis(stage, geom.Tokens.y)
        geom.SetStageMetersPerUnit(stage, metres_per_unit)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(points) - 1)
        own = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in name)
        mesh = geom.Mesh.Define(stage, f"/{own if own[:1].isalpha() or own[:1] == '_' else '_' + own}")
        stage.SetDefaultPrim(mesh.GetPrim())
        mesh.CreateSubdivisionSchemeAttr(geom.Tokens.none)
        mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
        mesh.CreateDisplayColorAttr([gf.Vec3f(*((np.array(colour) / 255) ** 2.2).tolist())])
        where, extent = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
        for i, p in enumerate(points):
            where.Set(vt.Vec3fArray.FromNumpy(p), i)
            extent.Set([gf.Vec3f(*p.min(axis=0).tolist()), gf.Vec3f(*p.max(axis=0).tolist())], i)
        stage.Save()
