"""The scene file: read, checked and turned into the views and tubes that sim works on."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from . import images
from .cameras import EXTRA, Shot, find_shot, listed_views, read_cameras
from .checks import Bounds, SceneError, Table, shown, suggest
from .frames import Frames
from .objects import OBJECT_KEYS, build_object
from .override import apply
from .sim.camera import Camera
from .sim.lens import Lens
from .sim.problem import Settings, Sheet, Snake, Tube, View
from .sim.track import Tracking

METRES = {"px": 1e-3, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048}
"""Units of the world in metres, in which GLB is written; there a pixel counts as a millimetre."""

# closed bounds of numbers, or the words allowed; what is not named here is bounded by its annotation alone
SETTINGS_BOUNDS: Bounds = {
    "scheme": ("auto", "adi", "jacobi", "euler", "sor", "direct"),
    "potential": ("map", "brightness"),
    "contour": ("subnode", "switch"),
    "force": ("normalised", "paper"),
    "visibility": ("depth", "rays", "off"),
    "sigmas": (0.1, 200.0),
    "iterations": (1, 1_000_000),
    "tolerance": (0.0, 1.0),
    "tau": (1e-4, 1.0),
    "gain": (0.0, 1e6),
    "step": (1e-6, 10.0),
    "slow": (1.0, 1000.0),
    "momentum": (0.0, 0.95),
}

TOP_KEYS = ["name", "units", "scale", "cameras", "images", "view", "object", "solver", "track", "output"]
TRACK_BOUNDS: Bounds = {"iterations": (1, 10_000), "first": ("rod", "rigid", "none"), "fps": (1e-6, 1e6)}
VIEW_KEYS = ["name", "image", "frames", "projection", "alpha", "K", "R", "t", "distortion", "P", "camera", "ignore"]
PROJECTION_KEYS = {
    "orthographic": [], "stereo": ["alpha"], "perspective": ["K", "R", "t", "distortion"], "matrix": ["P"],
    "file": ["camera"],
}  # fmt: skip
METRIC = ("perspective", "matrix", "file")
"""Projections that fix the world's scale."""


@dataclass(frozen=True)
class Output:
    """Which files a run writes; result.json always."""

    overlay: bool = True
    """overlay.png."""
    views: bool = True
    """views.png."""
    video: bool = True
    """reconstruction.mp4."""
    meshes: bool = True
    """OBJECT.ply, OBJECT.glb and OBJECT.npz."""
    potentials: bool = True
    """potentials.png and foreground.png."""
    video_fps: int = 30
    """frames a second, of both videos."""
    stages: bool | None = None
    """stages.png; None: where there are several tubes."""
    turning: bool = False
    """turning.mp4: all tubes together, once round."""


@dataclass
class Scene:
    """Everything a run needs, checked."""

    name: str
    views: list[View]
    tubes: list[Tube]
    settings: Settings
    lines: list[Snake | Sheet] = field(default_factory=list)
    """objects that are not tubes."""
    units: str = "px"
    """of the world, a key of METRES."""
    scale: float = 1.0
    """world units per pixel of an orthographic or stereo view."""
    output: Output = field(default_factory=Output)
    source: str = ""
    """the file it came from."""
    frames: list[Frames] = field(default_factory=list)
    """of each view, where the scene moves; the views hold the first."""
    tracking: Tracking = field(default_factory=Tracking)
    text: dict[str, Any] = field(default_factory=dict)
    """the tables as read, overrides included."""
    seconds: float = 0.0
    """that reading took."""


def find(path: str | Path) -> Path:
    """A scene file's path: itself, or the scene.toml of a folder."""
    path = Path(path)
    return path / "scene.toml" if path.is_dir() and (path / "scene.toml").is_file() else path


def load(path: str | Path, overrides: Iterable[str] = ()) -> Scene:
    """Read and check a scene file.

    Args:
        path: a TOML file, or a folder that holds scene.toml.
        overrides: texts KEY=VALUE as of `symseek run --set`: a dotted key and a TOML value,
            "solver.scheme=euler", "object.0.grid=[49, 49]"; "object.grid" means all objects,
            "object.squash.grid" the one of that name.

    Returns:
        the scene, with images read and lengths in world units.

    Raises:
        SceneError: anything unknown, missing or wrong; the message names file, field, value and remedy.
    """
    began = time.perf_counter()
    path = find(path)
    source, data = str(path), read(path, overrides)
    name = path.parent.name if path.stem == "scene" and path.parent.name else path.stem
    scene = build(data, path.parent, source, name)
    scene.seconds = time.perf_counter() - began
    return scene


def read(path: Path, overrides: Iterable[str] = ()) -> dict[str, Any]:
    """The tables of a scene file, not checked yet.

    Raises:
        SceneError: it cannot be read, is no TOML, or an override leads nowhere.
    """
    source = str(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        near = suggest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
        raise SceneError(source, "", "there is no such scene file", f"give the path of a TOML file{near}") from None
    except UnicodeDecodeError:
        raise SceneError(
            source,
            "",
            "is not text, so not a scene file",
            "write a scene file that names the photograph as view.image",
        ) from None
    except tomllib.TOMLDecodeError as problem:
        raise SceneError(source, "", f"is not valid TOML: {problem}", "mend that line") from None
    except OSError as problem:
        raise SceneError(source, "", f"cannot be read ({problem.strerror})", "give the path of a scene file") from None
    for override in overrides:
        apply(data, override, source)
    return data


def build(data: Mapping[str, Any], base: Path, source: str, name: str = "object", known: Scene | None = None) -> Scene:
    """Check the tables of a scene; images, Material and Settings may be objects already.

    Args:
        data: tables as in a scene file.
        base: folder that image paths are relative to.
        source: what messages call the scene.
        name: of the scene where it has none.
        known: a scene with these views, which are not read again.

    Raises:
        SceneError: as `load`.
    """
    top = Table(data, source, "", TOP_KEYS)
    if known is None:
        data, units, scale, views, frames = _views(top, base)
        top = Table(data, source, "", TOP_KEYS)
    else:
        units, scale, views, frames = known.units, known.scale, known.views, known.frames
    scene_name = top.name("name", name)
    objects = top.tables(
        "object",
        OBJECT_KEYS,
        "add an [[object]] with spine = [[x, y], [x, y], ...], its rough axis in pixels",
    )
    default_name = scene_name if len(objects) == 1 else None
    settings = top.fields("solver", Settings(), SETTINGS_BOUNDS)
    built = [build_object(table, views, scale, default_name, settings) for table in objects]
    names = [o.name for o in built]
    for i, table in enumerate(objects):
        if names[i] in names[:i]:
            table.fail("name", f"{names[i]!r} stands twice", "give every object a name of its own")
    tubes = [o for o in built if isinstance(o, Tube)]
    for table, o in zip(objects, built, strict=True):
        if isinstance(o, Tube) and o.figure in names:
            table.fail("figure", f"{o.figure!r} is an object's name", "give the figure a name of its own: both are files")
    lines = [o for o in built if not isinstance(o, Tube)]
    if not tubes and settings.scheme != Settings().scheme:
        top.fail(
            "solver.scheme", f"{settings.scheme!r} is for tubes", "leave it out: lines of snakes and sheets are factored"
        )
    if settings.sigmas and any(fine >= coarse for coarse, fine in pairwise(settings.sigmas)):
        top.fail("solver.sigmas", f"{list(settings.sigmas)} does not fall", "write them from coarse to fine")
    output = top.fields("output", Output(), {"video_fps": (1, 120)})
    tracking = top.fields("track", Tracking(), TRACK_BOUNDS)
    for table, o in zip(objects, built, strict=True):
        if not (frames and isinstance(o, Tube)) and any(spring.frame for spring in o.springs):
            table.fail("spring", "has a frame", "it is for tubes of moving scenes: remove it")
    if frames and lines:
        top.fail("object", "a snake or sheet does not move", "keep the tubes, or give image instead of frames")
    if "track" in top and not frames:
        top.fail("track", "is for moving scenes", 'give frames = "left.mp4" in each [[view]], or remove it')
    if tracking.fps is None and frames and frames[0].fps:
        tracking = replace(tracking, fps=frames[0].fps)
    return Scene(scene_name, views, tubes, settings, lines, units, scale, output, source, frames, tracking, dict(data))


def _views(top: Table, base: Path) -> tuple[Mapping[str, Any], str, float, list[View], list[Frames]]:
    """The tables, with the views that cameras' files list; units, scale, views and, if the scene moves, their frames."""
    data, units = top.data, top.text("units", "px", choices=METRES)
    shots: dict[str, Shot] = {}
    if "cameras" in top:
        shots = read_cameras(top, base)
        data = {"view": listed_views(shots), **data}
    elif "images" in top:
        top.fail("images", "stands without cameras", "give the cameras' file, or remove it")
    tables = Table(data, top.source, "", TOP_KEYS).tables("view", VIEW_KEYS, 'add a [[view]] with image = "photo.jpg"')
    scale = _scale(top, units, tables)
    read = [_view(table, base, scale, "front" if i == 0 else f"view{i + 1}", shots) for i, table in enumerate(tables)]
    views = [view for view, _ in read]
    for table in tables:
        if ("frames" in table) != ("frames" in tables[0]):
            table.fail("frames", "stands in some views and not in others", "give all views frames, or an image")
    for i, table in enumerate(tables):
        if views[i].name in [view.name for view in views[:i]]:
            table.fail("name", f"{views[i].name!r} stands twice", "give every view a name of its own")
    return data, units, scale, views, [frames for _, frames in read if frames is not None]


def _projection(view: Table, in_file: bool) -> str:
    return view.text("projection", "file" if in_file else "orthographic", choices=PROJECTION_KEYS)


def _scale(top: Table, units: str, views: list[Table]) -> float:
    projections = [_projection(view, "cameras" in top) for view in views]
    if all(projection in METRIC for projection in projections):
        if "scale" in top:
            top.fail(
                "scale",
                f"has no meaning beside a {projections[0]} view",
                "remove it: the camera fixes the world's scale",
            )
        return 1.0
    if units != "px" and "scale" not in top:
        top.fail(
            "scale",
            f"is missing, though units = {units!r}",
            f"give the {units} that one pixel spans, or leave units at px",
        )
    scale = top.number("scale", 1.0, above=0.0)
    if units == "px" and scale != 1.0:
        top.fail(
            "units",
            f"is px, though scale = {scale:g}",
            f"name the units that scale leads to: {', '.join(list(METRES)[1:])}",
        )
    return scale


def _view(
    table: Table, base: Path, scale: float, default_name: str, shots: Mapping[str, Shot]
) -> tuple[View, Frames | None]:
    if "frames" in table and "image" in table:
        table.fail("image", "stands beside frames", "give a photograph or frames, not both")
    projection = _projection(table, bool(shots))
    for key in (k for keys in PROJECTION_KEYS.values() for k in keys):
        if key in table and key not in PROJECTION_KEYS[projection]:
            owner = next(p for p, keys in PROJECTION_KEYS.items() if key in keys)
            table.fail(
                key,
                f"does not belong to a view that is {projection}",
                f'write projection = "{owner}", or remove it',
            )
    if projection == "file" and not shots:
        table.fail("projection", "is 'file', and the scene names none", 'give cameras = "sparse/0" or "transforms.json"')
    found = find_shot(table, shots) if projection == "file" else _camera(table, projection, scale)
    frames = Frames(table, base) if "frames" in table else None
    image = images.read(table, "image", base) if frames is None else frames.first
    camera, lens = found.fitted(table, image.shape) if isinstance(found, Shot) else (found, _lens(table, image))
    ignore = None
    if "ignore" in table:
        ignore = images.read(table, "ignore", base, mask=True) > 0.5
        if ignore.shape != image.shape[:2]:
            of_mask, of_image = (f"{s[1]} x {s[0]}" for s in (ignore.shape, image.shape))
            table.fail(
                "ignore",
                f"the mask has {of_mask} pixels and the image {of_image}",
                "give one of the image's size",
            )
        if ignore.all():
            table.fail(
                "ignore",
                "the mask covers the whole image",
                "white means: do not look here; leave the object black",
            )
    if lens is not None:
        image = lens.image(image)
        ignore = ~lens.covered if ignore is None else lens.mask(ignore)
        if frames is not None:
            frames.straighten(lens)
    name = table.name("name", default_name)
    return View(name=name, image=image, camera=camera, ignore=ignore, lens=lens), frames


def _lens(table: Table, image: np.ndarray) -> Lens | None:
    """What `distortion` of a perspective view says."""
    if "distortion" not in table:
        return None
    values = table.array("distortion", (None,), "a list of OpenCV's coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]]")
    if len(values) not in (4, 5, 8):
        table.fail("distortion", f"holds {len(values)} numbers", "give OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]: 4, 5 or 8")
    K = table.array("K", (3, 3), "a 3 x 3 matrix")
    if K[0, 1]:
        table.fail("K", f"{shown(K)} has a skew beside distortion", "OpenCV's model has none: undistort the image first")
    try:
        return Lens.opencv(K, values.tolist(), (image.shape[1], image.shape[0]))
    except ImportError:
        table.fail("distortion", "needs pycolmap, which is not installed", EXTRA)


def _camera(table: Table, projection: str, scale: float) -> Camera:
    why = f'projection = "{projection}" needs it'
    if projection == "stereo":
        return Camera.stereo(table.number("alpha", why=f"{why}: the paper's (15), signed"), scale)
    if projection == "perspective":
        K = table.array("K", (3, 3), "a 3 x 3 matrix", why=why)
        R = table.array("R", (3, 3), "a 3 x 3 matrix", why=why)
        t = table.array("t", (3,), "a vector", why=why)
        if not np.allclose(K[2], [0, 0, 1]) or K[0, 0] <= 0 or K[1, 1] <= 0:
            table.fail(
                "K",
                f"{shown(K)} is not a camera matrix",
                "it must be [[f, s, x0], [0, f, y0], [0, 0, 1]] with f above 0, in pixels",
            )
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0:
            table.fail(
                "R",
                f"{shown(R)} is not a rotation",
                "its rows must be unit vectors at right angles, its determinant +1",
            )
        return Camera.perspective(K, R, t)
    if projection == "matrix":
        P = table.array("P", (3, 4), "a 3 x 4 matrix", why=why)
        if np.linalg.matrix_rank(P) < 3 or (np.allclose(P[2, :3], 0) and not np.isclose(P[2, 3], 1)):
            table.fail(
                "P",
                f"{shown(P)} is not a camera",
                "it must have rank 3, and the last row 0 0 0 1 where it is affine",
            )
        return Camera(P)
    return Camera.orthographic(scale)
