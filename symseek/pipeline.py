"""From a scene to a result and its files: where sim and render meet."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import __version__
from .checks import SceneError
from .device import prepare
from .folder import staging
from .frames import together
from .scene import Output, Scene, build, load
from .sim import reconstruct as still
from .sim.figure import Figure, figures
from .sim.kept import Kept
from .sim.material import Material
from .sim.problem import Settings
from .sim.snake import LineResult, deform
from .sim.track import track
from .sim.visibility import cast_rays

if TYPE_CHECKING:
    from .render.visibility import DepthPass

Callback = Callable[[Any], "bool | None"]
"""Called with a `Progress` each iteration or a `Shown` each frame; returning True stops, and the rest is measured."""


@dataclasses.dataclass(kw_only=True)
class Result(still.Result):
    """What was found: `objects` with their meshes and measures, and how to save it all."""

    scene: Scene
    device: str
    lines: list[LineResult] = dataclasses.field(default_factory=list)
    """snakes and sheets."""
    figures: list[Figure] = dataclasses.field(default_factory=list)
    """tubes united, see the scene file's `figure`."""
    files: list[Path] = dataclasses.field(default_factory=list)
    """written last."""
    skipped: dict[str, str] = dataclasses.field(default_factory=dict)
    """files that were asked for and could not be made, and why."""

    def save(self, out: str | Path, tell: Callable[[str], None] = lambda text: None) -> list[Path]:
        """Write the files of a run, all or none; without OpenGL all but views and video, see `skipped`.

        Args:
            out: folder, made if it is not there.
            tell: called with a line of text before each slow part.

        Returns:
            paths of the files.

        Raises:
            SceneError: the folder cannot be written.
        """
        out = Path(out)
        with staging(out) as stage:
            return self._write(stage, out, tell)

    def _write(self, stage: Path, out: Path, tell: Callable[[str], None]) -> list[Path]:
        from .files import write  # pyrender and PyAV load half a second

        self.files = [out / name for name in write(self, stage, tell)]
        return self.files


def reconstruct(
    image: Scene | str | Path | np.ndarray | None = None,
    spine: Iterable[Any] | None = None,
    *,
    views: Iterable[Mapping[str, Any]] | None = None,
    cameras: str | Path | None = None,
    images: str | Path | None = None,
    spines: Mapping[str, Any] | None = None,
    objects: Iterable[Mapping[str, Any]] | None = None,
    name: str = "object",
    radius: float | None = None,
    depth: float | str = 0.0,
    grid: tuple[int, int] = (25, 25),
    units: str = "px",
    scale: float | None = None,
    ignore: str | Path | np.ndarray | None = None,
    not_here: Iterable[Any] = (),
    material: Material | Mapping[str, float] | None = None,
    settings: Settings | Mapping[str, Any] | None = None,
    output: Output | Mapping[str, Any] | None = None,
    device: str = "cpu",
    callback: Callback | None = None,
) -> Result:
    """Reconstruct one object from one orthographic photograph or from several views, or a whole scene.

    Args:
        image: path, "skimage:NAME", or array of shape (H, W) or (H, W, 1 to 4); or a Scene, which says all
            that the other arguments but `device` and `callback` would.
        spine: rough axis, shape (n, 2), image points (column, row) of the first view, or (n, 3), world points.
        views: instead of an image, views with the keys of a scene file, such as
            {"name": "left", "image": ..., "projection": "matrix", "P": ...}.
        cameras: file or folder of their cameras, as in a scene file; without `views`, all its images are views.
        images: folder of the images that `cameras` names.
        spines: instead of a spine, rough axes in two views or more by their names, shape (n, 2) each.
        objects: instead of a spine, objects with the keys of a scene file, such as
            {"kind": "snake", "points": ..., "spring": [{"near": ..., "anchor": ...}]}.
        name: of the object and its files.
        radius: of the first tube [units]; None: from the image.
        depth: of the spine [units], or "auto": found from the image, where objects hide each other.
        grid: nodes around, nodes along.
        units: of the world, "px" or "mm" and the like.
        scale: units per pixel, needed where units are not "px".
        ignore: mask (H, W) of what not to look at, or its file.
        not_here: marks where the object is not, shape (k, 2), image points.
        material: of the tube, whole or only what differs from the defaults.
        settings: of the solver, likewise.
        output: which files `save` writes, likewise.
        device: Warp device.
        callback: called each iteration with a Progress; returning True stops.

    Returns:
        the result, whose `save` writes all files.

    Raises:
        SceneError: an argument is at fault; its message names it as a scene file would.
    """
    if isinstance(image, Scene):
        if spine is not None:
            raise TypeError("a Scene holds its spines: give no spine beside it")
        return _solve(image, device, callback)
    if (image is None) == (views is None and cameras is None):
        raise TypeError("give an image, or views or the file of their cameras")
    if image is None and ignore is not None:
        raise TypeError("give ignore as a key of the view that it is for")
    seen = [{"image": image} | ({} if ignore is None else {"ignore": ignore})] if image is not None else views
    tube: dict[str, Any] = {"name": name, "depth": depth, "grid": tuple(grid)}
    tube |= {} if spine is None else {"spine": np.asarray(_listed(spine))}
    tube |= {} if spines is None else {"spines": {view: np.asarray(_listed(axis)) for view, axis in spines.items()}}
    tube |= {} if radius is None else {"radius": radius}
    marks = _listed(not_here)
    tube |= {"not_here": np.asarray(marks)} if len(marks) else {}
    tube |= {} if material is None else {"material": material}
    given = [tube] if objects is None else [dict(o) for o in objects]
    if objects is not None and (spine is not None or spines is not None):
        raise TypeError("give a spine or objects, not both")
    data: dict[str, Any] = {"name": name, "units": units, "object": given}
    data |= {} if seen is None else {"view": [dict(view) for view in seen]}
    data |= {} if cameras is None else {"cameras": str(cameras)}
    data |= {} if images is None else {"images": str(images)}
    data |= {} if scale is None else {"scale": scale}
    data |= {} if settings is None else {"solver": settings}
    data |= {} if output is None else {"output": output}
    return _solve(build(data, Path.cwd(), "reconstruct"), device, callback)


def _listed(points: Iterable[Any]) -> Any:
    return points if isinstance(points, list | tuple | np.ndarray) else list(points)


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    device: str = "cpu",
    *,
    overrides: Iterable[str] = (),
    callback: Callback | None = None,
    every: int = 1,
    threads: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
    resume: bool = False,
) -> Result:
    """Reconstruct a scene and write its files, as `symseek run` does.

    Args:
        scene: a scene, or the path of a scene file.
        out: folder for the files; None: out/NAME in the working folder.
        device: Warp device.
        overrides: KEY=VALUE texts, for a path.
        callback: called each iteration; returning True stops the solver.
        every: iterations between two calls, of tubes; more spare time where there are many.
        threads: that share the tubes; None: one a core.
        tell: called with a line of text before each slow part.
        resume: a moving scene goes on from the last whole frame of a run to the same folder that was stopped.

    Returns:
        the result; its `files` are what was written.

    Raises:
        SceneError: scene, device or folder at fault; nothing was written.
    """
    if not isinstance(scene, Scene):
        scene = load(scene, overrides)
    out = Path("out") / scene.name if out is None else Path(out)
    with staging(out) as stage:
        kept = _kept(scene, out, resume)
        result = _solve(scene, device, callback, every, threads, kept)
        result._write(stage, out, tell)
    if kept is not None:
        kept.path.unlink()
    return result


def _kept(scene: Scene, out: Path, resume: bool) -> Kept | None:
    """Where a moving scene keeps its frames while it runs."""
    if not scene.frames:
        if resume:
            raise SceneError(scene.source, "", "is no moving scene", "run it without --resume")
        return None
    tables = [view.camera.matrix.tolist() for view in scene.views], scene.tubes, scene.settings, scene.tracking
    stamp = hashlib.sha256(repr((scene.name, tables, __version__)).encode()).hexdigest()
    try:
        return Kept(out / f"{scene.name}.kept", stamp, resume)
    except ValueError as problem:
        raise SceneError(str(out), "", str(problem), "run it without --resume") from problem


class DepthPasses:
    """Depth passes by OpenGL, or where there is none by rays; OpenGL is not touched unless something may be hidden."""

    def __init__(self) -> None:
        self._drawn: DepthPass | None = None
        self.lacks = False

    def __enter__(self) -> DepthPasses:
        return self

    def __exit__(self, *problem: object) -> None:
        if self._drawn is not None:
            self._drawn.close()

    def __call__(
        self, meshes: Sequence[tuple[np.ndarray, np.ndarray]], shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        from .render.visibility import DepthPass, RenderError

        if not self.lacks:
            self._drawn = self._drawn or DepthPass()
            try:
                return self._drawn(meshes, shape)
            except RenderError:
                self.lacks = True
        return cast_rays(meshes, shape)


def _solve(
    scene: Scene,
    device: str,
    callback: Callback | None,
    every: int = 1,
    threads: int | None = None,
    kept: Kept | None = None,
) -> Result:
    prepare(device)
    lines: list[LineResult] = []
    united: list[Figure] = []
    found = still.Result([], [], None, {}, scene.settings)
    try:
        if scene.frames:
            frames = together(scene.frames)
            found = track(frames, scene.views, scene.tubes, scene.settings, scene.tracking, device, callback, kept)
            scene = dataclasses.replace(scene, views=found.views)
        elif scene.tubes:
            with DepthPasses() as look:
                found = still.reconstruct(scene.views, scene.tubes, scene.settings, device, callback, every, threads, look)
            if look.lacks:
                found.settings = dataclasses.replace(found.settings, visibility="rays")
            if any(tube.figure for tube in scene.tubes):
                began = time.perf_counter()
                united = figures(scene.tubes, found.objects)
                found.seconds["unite"] = time.perf_counter() - began
        if scene.lines:
            more = deform(scene.views, scene.lines, scene.settings, device, callback)
            lines = more.objects
            found.seconds = {k: found.seconds.get(k, 0.0) + more.seconds.get(k, 0.0) for k in found.seconds | more.seconds}
            if not scene.tubes:
                found.potentials, found.foreground = more.potentials, more.foreground
    except ValueError as problem:  # bounds that only the solver knows, as a step too long for the scheme
        raise SceneError(scene.source, "solver", str(problem)) from problem
    found.seconds = {"read": scene.seconds, **found.seconds}
    return Result(**vars(found), scene=scene, device=device, lines=lines, figures=united)
