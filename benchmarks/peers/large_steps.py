"""Peer of several views: Mitsuba 3 with large steps (Nicolet et al. 2021), a free mesh made to cover the masks.

Needs the extra `peers`. The masks are the true coverages. Silhouettes are differentiated at the mesh's primary
visibility; the mesh starts as an ellipsoid about the rough axis that the other methods start from.
"""

from __future__ import annotations

import importlib
from typing import Any, cast

import numpy as np
import trimesh
from scipy import ndimage
from scipy.linalg import rq

from symseek.scenes.views import Views
from symseek.sim.camera import Camera

SIZE = 128
"""Of the images, which are reduced."""
STEPS, SAMPLES = 200, 8
"""Of Adam, each by all views of a pair or two of a ring; samples a pixel."""
RATE, SMOOTH = 0.02, 19.0
"""Of Adam, in lengths of the axis, falling to a tenth; lambda of the large steps, the authors' own."""
BRIGHT = 1.0


def large_steps(made: Views, rough: np.ndarray, steps: int = STEPS) -> tuple[np.ndarray, np.ndarray]:
    """Mesh (V, 3), (F, 3) that covers the masks of all views, which must be of perspective cameras.

    Args:
        made: images with their true coverages and cameras.
        rough: rough axis, shape (n, 3).
        steps: of Adam.

    Raises:
        ImportError: mitsuba or cholespy is not installed.
    """
    dr, mi = (cast(Any, importlib.import_module(name)) for name in ("drjit", "mitsuba"))
    mi.set_variant("llvm_ad_rgb")
    vertices, faces = ellipsoid(rough, thickness(made, rough))
    mesh = mi.Mesh("solid", len(vertices), len(faces), props=_emitter(mi))
    shape = mi.traverse(mesh)
    shape["vertex_positions"] = mi.Float(vertices.ravel())
    shape["faces"] = mi.UInt(faces.ravel())
    shape.update()
    views = list(zip(made.cameras, made.coverages, strict=True))
    world: dict[str, Any] = {"type": "scene", "mesh": mesh}
    world |= {f"eye{v}": _sensor(mi, camera, cover.shape[0]) for v, (camera, cover) in enumerate(views)}
    world["integrator"] = {"type": "direct_projective", "sppi": 0}
    scene = mi.load_dict(world)
    targets = [mi.TensorXf(BRIGHT * reduced(cover)[..., None].repeat(3, axis=2)) for _, cover in views]
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith("vertex_positions"))
    steep = mi.ad.LargeSteps(params[key], params[key.replace("vertex_positions", "faces")], SMOOTH)
    adam = mi.ad.Adam(lr=RATE * made.length, uniform=True)
    adam["u"] = steep.to_differential(params[key])
    rng, used = np.random.default_rng(0), min(2, len(views))
    for step in range(steps):
        adam.set_learning_rate(RATE * made.length * 0.1 ** (step / steps))
        params[key] = steep.from_differential(adam["u"])
        params.update()
        loss = 0.0
        for v in rng.permutation(len(views))[:used].tolist():
            image = mi.render(scene, params, sensor=v, spp=SAMPLES, seed=2 * step * len(views) + v)
            loss += dr.mean(dr.square(image - targets[v]), axis=None)
        dr.backward(loss)
        adam.step()
    found = np.array(steep.from_differential(adam["u"])).reshape(-1, 3)
    return found.astype(float), faces


def _emitter(mi: Any) -> Any:
    props = mi.Properties()
    props["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": BRIGHT}})
    return props


def _sensor(mi: Any, camera: Camera, size: int) -> Any:
    """Mitsuba's camera looks along +Z with X to the left and Y up."""
    focal, turn = rq(camera.matrix[:, :3])
    sign = np.diag(np.sign(np.diag(focal)))
    focal, turn = focal @ sign, sign @ turn
    if np.linalg.det(turn) < 0:
        raise ValueError("the camera mirrors")
    pose = np.eye(4)
    pose[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ turn
    pose[:3, 3] = np.diag([-1.0, -1.0, 1.0]) @ np.linalg.solve(focal, camera.matrix[:, 3])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    film["sample_border"] = True
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(size * focal[2, 2] / (2 * focal[0, 0])))),
            "near_clip": 1.0,
            "far_clip": 1e5,
            "to_world": mi.ScalarTransform4f(np.linalg.inv(pose)),
            "film": film,
        }
    )


def thickness(made: Views, rough: np.ndarray) -> float:
    """Width of the masks over the length of the rough axis in their images, at most; a mean over views."""
    views = zip(made.cameras, made.coverages, strict=True)
    shares = []
    for camera, cover in views:
        seen = camera.project(rough)
        inside = np.asarray(ndimage.distance_transform_edt(cover >= 0.5))
        shares.append(2 * inside.max() / np.linalg.norm(seen[-1] - seen[0]))
    return float(np.mean(shares))


def reduced(cover: np.ndarray) -> np.ndarray:
    """A coverage of `SIZE` by `SIZE` pixels, by area."""
    at = np.arange(SIZE + 1) * cover.shape[0] / SIZE
    whole = np.zeros((cover.shape[0] + 1, cover.shape[1] + 1))
    whole[1:, 1:] = cover.astype(float).cumsum(axis=0).cumsum(axis=1)
    knots = np.arange(cover.shape[0] + 1)
    rows = np.stack([np.interp(at, knots, column) for column in whole.T], axis=1)
    both = np.stack([np.interp(at, knots, row) for row in rows], axis=0)
    return (np.diff(np.diff(both, axis=0), axis=1) * (SIZE / cover.shape[0]) ** 2).astype(np.float32)


def ellipsoid(rough: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an ellipsoid from end to end of an axis, `width` times as wide, outward."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    chord = rough[-1] - rough[0]
    length = np.linalg.norm(chord)
    along = chord / length
    around = np.linalg.svd(np.eye(3) - np.outer(along, along))[0][:, :2]
    frame = np.column_stack([around, along])
    frame *= np.sign(np.linalg.det(frame))
    size = 0.5 * length * np.array([width, width, 1.0])
    return (rough[0] + rough[-1]) / 2 + (size * np.asarray(ball.vertices)) @ frame.T, np.asarray(ball.faces)
