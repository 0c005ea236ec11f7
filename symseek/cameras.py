"""Cameras from files: COLMAP's models, text or binary, by pycolmap; nerfstudio's transforms.json.

Their pixels have centres at .5, ours at whole numbers, so that principal points move by half a pixel. COLMAP's poses take
the world to camera axes (X right, Y down, Z away), as ours do; nerfstudio's take camera axes (X right, Y up, Z back) to the
world. The world stays the file's own.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from .checks import SceneError, Table, shown, suggest
from .sim.camera import Camera
from .sim.lens import BENT, Lens

COLMAP = ("cameras", "images")
"""Files of a COLMAP model that must be there, .bin or .txt."""
EXTRA = "pip install 'symseek[cameras]'"
PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")
LENSES = {"OPENCV": ("k1", "k2", "p1", "p2", "k3"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4")}
"""nerfstudio's camera models and their coefficients."""


@dataclass(frozen=True)
class Shot:
    """The camera of one image, as its file has it."""

    K: np.ndarray
    """shape (3, 3), pixel centres at .5."""
    pose: np.ndarray
    """world to camera, shape (3, 4), X right, Y down, Z away."""
    size: tuple[int, int]
    """width, height of its image [px]."""
    path: Path
    """of its image."""
    lens: Lens | None = None

    def fitted(self, table: Table, shape: tuple[int, ...]) -> tuple[Camera, Lens | None]:
        """Camera and lens for an image of this shape, which may be the original scaled.

        Raises:
            SceneError: it is no scaled original.
        """
        height, width = shape[:2]
        scale = np.array([width, height]) / self.size
        if np.abs(scale[0] * self.size[1] - height) > 1 and np.abs(scale[1] * self.size[0] - width) > 1:
            table.fail(
                "image",
                f"has {width} x {height} pixels, its camera {self.size[0]} x {self.size[1]}",
                "give the image its camera was found for, scaled if you like; if its EXIF data turn it, save it turned",
            )
        K = self.K.copy()
        K[:2] *= scale[:, None]
        K[:2, 2] -= 0.5
        lens = self.lens if self.lens is None or self.size == (width, height) else self.lens.scaled((width, height))
        return Camera.perspective(K, self.pose[:, :3], self.pose[:, 3]), lens


def read_cameras(top: Table, base: Path) -> dict[str, Shot]:
    """The cameras that the scene's `cameras` names, by the names that their images have in the file.

    Args:
        top: the scene's table with `cameras`, a folder with COLMAP's files or a nerfstudio .json, and `images`, the folder
            of the images that they name; by default "images" beside the scene file, or the folder of the .json.
        base: folder of the scene file.

    Raises:
        SceneError: not there, not readable, or a camera that no pinhole can stand for.
    """
    path = base / top.text("cameras")
    colmap = path.is_dir()
    if not path.exists() or (not colmap and path.suffix.lower() != ".json"):
        what = "is neither a folder nor a .json file" if path.exists() else "does not exist"
        near = suggest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
        top.fail("cameras", f"{str(path)!r} {what}", f"give COLMAP's folder, as sparse/0, or a transforms.json{near}")
    folder = base / top.text("images", "images") if colmap or "images" in top else path.parent
    try:
        shots = _colmap(top, path, folder) if colmap else _nerfstudio(path, folder)
    except ImportError:
        top.fail("cameras", f"{str(path)!r} needs pycolmap, which is not installed", EXTRA)
    if not shots:
        top.fail("cameras", f"{str(path)!r} holds no image with a camera", "give a model with registered images")
    return shots


def find_shot(table: Table, shots: Mapping[str, Shot]) -> Shot:
    """The camera of a [[view]]: by `camera`, or by the name of its image or frames.

    Raises:
        SceneError: none, or several.
    """
    key = "camera" if "camera" in table else "image" if "image" in table else "frames"
    value = table.take(key)
    if not isinstance(value, str | Path):
        table.fail("camera", "is missing", f"name the view's image in the cameras' file, as {next(iter(shots))!r}")
    name = str(value)
    if name in shots:
        return shots[name]
    same = [known for known in shots if Path(known).name == Path(name).name]
    if len(same) == 1:
        return shots[same[0]]
    what = f"fits {' and '.join(map(repr, same[:2]))}" if same else "is no image of the cameras' file"
    table.fail(key, f"{name!r} {what}", f"name its image in that file by camera{suggest(name, shots)}")


def listed_views(shots: Mapping[str, Shot]) -> list[dict[str, Any]]:
    """[[view]] tables of all images of a file, named after them."""
    return [
        {"name": "_".join(Path(name).with_suffix("").parts), "image": str(shot.path), "camera": name}
        for name, shot in sorted(shots.items())
    ]


def _colmap(top: Table, path: Path, folder: Path) -> dict[str, Shot]:
    import pycolmap

    kind = next((k for k in (".bin", ".txt") if all((path / f"{f}{k}").is_file() for f in COLMAP)), "")
    if not kind:
        near = next((f"; {p.name} in it does" for p in sorted(path.iterdir()) if (p / "images.bin").is_file()), "")
        top.fail(
            "cameras", f"{str(path)!r} holds no cameras and images, .txt or .bin", f"give COLMAP's folder, as sparse/0{near}"
        )
    with tempfile.TemporaryDirectory() as copy:
        # without the points, which are not needed, may be missing, and may be many
        for name in (*COLMAP, "rigs", "frames"):
            if (file := path / f"{name}{kind}").is_file():
                shutil.copy(file, copy)
        Path(copy, f"points3D{kind}").write_bytes(bytes(8) if kind == ".bin" else b"")
        try:
            model = pycolmap.Reconstruction(copy)
        except (ValueError, RuntimeError, IndexError) as problem:
            top.fail("cameras", f"{str(path)!r} cannot be read ({problem})", "save the model again by COLMAP")
    shots = {}
    for image in model.images.values():
        if not image.has_pose:
            continue
        camera = model.cameras[image.camera_id]
        name = camera.model.name
        if name == "EQUIRECTANGULAR":
            top.fail("cameras", f"{str(path)!r} has a camera of model {name}", "cut perspective images out of the panorama")
        size = (camera.width, camera.height)
        bent = "FISHEYE" in name or bool(np.any(np.abs(camera.params[camera.extra_params_idxs()]) > BENT))
        lens = Lens(name, camera.params.tolist(), size) if bent else None
        shots[image.name] = Shot(
            camera.calibration_matrix(), image.cam_from_world().matrix(), size, folder / image.name, lens
        )
    return shots


def _nerfstudio(path: Path, folder: Path) -> dict[str, Shot]:
    def fail(field: str, problem: str, remedy: str) -> NoReturn:
        raise SceneError(str(path), field, problem, remedy)

    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        fail("", f"cannot be read as JSON ({problem})", "give nerfstudio's transforms.json")
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list):
        fail("frames", "is missing", "give nerfstudio's transforms.json")
    shots = {}
    for i, frame in enumerate(frames):
        where = f"frames[{i}]"
        both = {**{k: v for k, v in data.items() if k != "frames"}, **frame} if isinstance(frame, dict) else {}
        table = Table(both, str(path), where, both)
        name = table.text("file_path", why="each frame names its image")
        f_x, f_y, c_x, c_y = (
            table.number(k, why="the focal lengths and the principal point [px]") for k in ("fl_x", "fl_y", "cx", "cy")
        )
        size = int(table.number("w", above=0, why="the width [px]")), int(table.number("h", above=0, why="the height [px]"))
        K = np.array([[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1.0]])
        back = table.array("transform_matrix", (4, 4), "a 4 x 4 matrix", why="each frame has its pose")
        back = back @ np.diag([1.0, -1, -1, 1])
        R = back[:3, :3].T
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
            fail(f"{where}.transform_matrix", f"{shown(back)} is not a pose", "its first 3 x 3 must be a rotation")
        shots[name] = Shot(K, np.column_stack([R, -R @ back[:3, 3]]), size, folder / name, _bend(table, K, size))
    return shots


def _bend(table: Table, K: np.ndarray, size: tuple[int, int]) -> Lens | None:
    """The lens of a nerfstudio frame, if it bends."""
    model = table.text("camera_model", "OPENCV", choices=(*PINHOLES, *LENSES))
    if model in PINHOLES:
        return None
    values = [table.number(k, 0.0) for k in LENSES[model]]
    if model == "OPENCV" and abs(table.number("k4", 0.0)) > BENT:
        table.fail("k4", "bends in a way that is not OpenCV's", "undistort the images first")
    if model == "OPENCV" and not np.any(np.abs(values) > BENT):
        return None
    flat = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    if model == "OPENCV" and values[4]:
        return Lens("FULL_OPENCV", [*flat, *values, 0, 0, 0], size)
    return Lens(model, [*flat, *values[:4]], size)
