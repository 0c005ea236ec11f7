"""The files of a run: record, meshes, arrays, pictures and video."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import __version__
from .doctor import versions
from .folder import RECORD
from .render.evolution import Snapshot, evolution_frames
from .render.export import write_glb, write_ply
from .render.figures import potentials_sheet, views_sheet
from .render.files import write_picture
from .render.lines import Colour
from .render.overlay import Drawing, draw_overlay
from .render.platform import RenderError
from .render.video import write_mp4
from .scene import METRES
from .sim.camera import Camera
from .sim.fields import Cut
from .sim.problem import Sheet, Snake, Tube, View
from .sim.result import ObjectResult
from .sim.snake import LineResult, grid_lines, outline, sheet_mesh
from .sim.surface import occluding_contour, refine, wire

if TYPE_CHECKING:
    from .pipeline import Result

COLOURS = [(226, 142, 52), (86, 160, 211), (122, 182, 72), (204, 102, 153), (230, 200, 80), (150, 130, 205)]
"""sRGB of the objects, in turn."""
SNAPSHOTS = 90
"""Most states of the deformation that the video shows."""
ASTRAY = "the model has grown out of the image"
FORMS = {
    "adi": "alternating directions, section 5",
    "jacobi": "implicit Jacobi, section 5",
    "euler": "explicit Euler, section 5",
    "map": "foreground map (ours)",
    "brightness": "brightness of the image, the paper's (11)",
    "subnode": "contour between nodes (ours)",
    "switch": "hard switch on nodes, the paper's (12)",
    "normalised": "pull normalised by scale and contrast (ours)",
    "depth": "hidden parts by a depth pass",
    "rays": "hidden parts by rays",
    "off": "hidden parts count as seen",
    "paper": "plain gradient of the potential, the paper's (11)",
}
"""What the words of the solver's settings stand for."""


def write(result: Result, folder: Path, tell: Callable[[str], None]) -> list[str]:
    """Write all files that the scene's [output] asks for into an existing folder.

    Without OpenGL the shaded views and the video are left out, and `result.skipped` says why.

    Args:
        result: of a run.
        folder: to write into.
        tell: called with a line of text before the slow parts.

    Returns:
        names of the files, record first.
    """
    want, clock = result.scene.output, time.perf_counter()
    result.skipped = {}

    def phase(name: str, text: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        result.seconds[name] = now - clock
        clock = now
        if text:
            tell(text)

    if want.meshes:
        _write_meshes(result, folder)
    phase("meshes", "drawing pictures ...")
    _write_pictures(result, folder)
    phase("pictures", "rendering the video ..." if want.video else "")
    if want.video:
        _write_video(result, folder / "reconstruction.mp4")
        phase("video", "")
    names = [RECORD, *sorted(f.name for f in folder.iterdir())]
    text = json.dumps(_record(result, names), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / RECORD).write_text(text + "\n", encoding="utf-8")
    return names


def front(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Rotation, shape (3, 3), from the world to a view's (right, down, away) at a point, shape (3,)."""
    m = camera.matrix
    away = camera.sight(point)
    # gradient of the column, but for a factor above 0
    across = (m[0, :3] - camera.project(point)[0] * m[2, :3]) * np.sign(m[2, :3] @ point + m[2, 3])
    right = across - away * (across @ away)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right), away])


def _write_meshes(result: Result, folder: Path) -> None:
    scene = result.scene

    def mesh(name: str, vertices: np.ndarray, faces: np.ndarray, colour: Colour) -> None:
        write_ply(folder / f"{name}.ply", vertices, faces, scene.units)
        write_glb(folder / f"{name}.glb", vertices, faces, METRES[scene.units], colour, name)

    for o, colour in zip(result.objects, _colours(), strict=False):
        mesh(o.name, o.vertices, o.faces, colour)
        np.savez_compressed(
            folder / f"{o.name}.npz",
            tube=o.tube,
            spine=o.spine,
            velocity=o.velocity,
            time=np.zeros(len(o.tube)),
            units=np.array(scene.units),
        )
    for o, colour in zip(result.lines, _colours(len(result.objects)), strict=False):
        if o.kind == "sheet":
            mesh(o.name, *sheet_mesh(o.nodes[0]), colour)
        units = np.array("px" if o.kind == "snake" else scene.units)
        arrays = {("curve" if o.kind == "snake" else o.kind): o.nodes, "time": np.zeros(len(o.nodes)), "units": units}
        np.savez_compressed(folder / f"{o.name}.npz", **arrays)


def _write_pictures(result: Result, folder: Path) -> None:
    want, view = result.scene.output, result.scene.views[0]
    solid = [*result.objects, *(o for o in result.lines if o.kind == "sheet")]
    astray = not all(_in_reach(view, o, -1) for o in [*result.objects, *result.lines])
    lost = {"overlay": want.overlay and astray, "views": want.views and astray and bool(solid)}
    result.skipped |= {f"{name}.png": ASTRAY for name, left_out in lost.items() if left_out}
    if want.overlay and not astray:
        drawings = [
            _drawing(tube, view.camera, o.tube[0], o.spine[0], o.contour, o.support, o.cuts, o.hidden)
            for tube, o in zip(result.scene.tubes, result.objects, strict=True)
        ]
        drawings += [
            _line_drawing(given, view.camera, o.history[-1], o.contour, o.support)
            for given, o in zip(result.scene.lines, result.lines, strict=True)
        ]
        write_picture(folder / "overlay.png", draw_overlay(view.image, drawings))
    if want.potentials and result.potentials:
        sheet = potentials_sheet([(p.sigma, p.image) for p in result.potentials])
        write_picture(folder / "potentials.png", sheet)
    if want.potentials and result.foreground is not None:
        write_picture(folder / "foreground.png", np.rint(255 * np.clip(result.foreground, 0, 1)).astype(np.uint8))
    if want.views and solid and not astray:
        meshes = [(*_mesh(o, -1), colour) for o, colour in zip(solid, _colours(), strict=False)]
        wires = [
            line
            for o in solid
            for line in (wire(o.tube[0], cuts=o.cuts) if isinstance(o, ObjectResult) else grid_lines(o.nodes[0]))
        ]
        try:
            write_picture(folder / "views.png", views_sheet(meshes, wires, _front(result)))
        except RenderError as problem:
            result.skipped["views.png"] = str(problem)


def _write_video(result: Result, path: Path) -> None:
    view, fps = result.scene.views[0], result.scene.output.video_fps
    objects = [*result.objects, *result.lines]
    # a run that went astray may have states that no picture can hold
    fit = [[i for i in range(len(o.history)) if _in_reach(view, o, i)] for o in objects]
    if not all(fit):
        result.skipped[path.name] = ASTRAY
        return
    count = min(SNAPSHOTS, max(map(len, fit)))
    shown = zip(*(np.array(i)[np.rint(np.linspace(0, len(i) - 1, count)).astype(int)] for i in fit), strict=True)
    snapshots = [_snapshot(result, states) for states in shown]
    try:
        write_mp4(path, evolution_frames(view.image, snapshots, COLOURS, fps, front=_front(result)), fps)
    except RenderError as problem:
        result.skipped[path.name] = str(problem)


def _colours(first: int = 0) -> Iterator[Colour]:
    """Colours of objects, in turn."""
    return itertools.islice(itertools.cycle(COLOURS), first, None)


def _front(result: Result) -> np.ndarray:
    """`front` at the middle of the first object that lies in the world; at its origin where all are snakes."""
    places = [o.spine[0] for o in result.objects] + [o.nodes[0] for o in result.lines if o.kind == "sheet"]
    middle = places[0].reshape(-1, 3).mean(axis=0) if places else np.zeros(3)
    return front(result.scene.views[0].camera, middle)


def _in_reach(view: View, o: ObjectResult | LineResult, i: int) -> bool:
    """Whether state i of an object can be drawn."""
    nodes = o.history[i][0]
    return in_reach(View(view.image) if isinstance(o, LineResult) and o.kind == "snake" else view, nodes)


def _mesh(o: ObjectResult | LineResult, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Mesh of state i of a tube, or of a sheet with both its sides, to be shaded."""
    if isinstance(o, LineResult):
        vertices, faces = sheet_mesh(o.history[i][0])
        return np.concatenate([vertices, vertices]), np.concatenate([faces, faces[:, ::-1] + len(vertices)])
    nodes, _, _, cuts = o.history[i]
    return (o.vertices, o.faces) if i == -1 else refine(nodes, 64, 3 * nodes.shape[1], cuts)


def in_reach(view: View, nodes: np.ndarray) -> bool:
    """Whether nodes, shape (..., 3), lie in the image or at most three of its sides from it."""
    sides = np.array(view.image.shape[1::-1])
    with np.errstate(all="ignore"):
        points = view.camera.project(nodes)
        return bool(np.all(np.isfinite(nodes)) and np.all(np.abs(points - sides / 2) < 3.5 * sides))


def _snapshot(result: Result, states: Sequence[int]) -> Snapshot:
    camera = result.scene.views[0].camera
    objects = [*result.objects, *result.lines]
    drawings = []
    for given, o, i in zip([*result.scene.tubes, *result.scene.lines], objects, states, strict=True):
        if isinstance(o, LineResult):
            assert not isinstance(given, Tube)
            drawings.append(_line_drawing(given, camera, o.history[i], [outline(given, o.history[i][0], camera)], ()))
        else:
            assert isinstance(given, Tube)
            nodes, spine, _, cuts = o.history[i]
            contour = [points for points, _ in occluding_contour(nodes, camera, cuts)]
            drawings.append(_drawing(given, camera, nodes, spine, contour, (), cuts))
    meshes = [
        _mesh(o, i) for o, i in zip(objects, states, strict=True) if not isinstance(o, LineResult) or o.kind == "sheet"
    ]
    return Snapshot(drawings, meshes, f"sigma {objects[0].history[states[0]][2]:.3g} px")


def _drawing(
    tube: Tube,
    camera: Camera,
    nodes: np.ndarray,
    spine: np.ndarray,
    contour: Any,
    support: Any,
    cuts: Sequence[Cut],
    hidden: Sequence[np.ndarray] = (),
) -> Drawing:
    given = tube.spine if tube.spine.shape[1] == 2 else camera.project(tube.spine)
    wires = [camera.project(line) for line in wire(nodes, cuts=cuts)]
    return Drawing(wires, contour, support, given, camera.project(spine), hidden=hidden)


def _line_drawing(given: Snake | Sheet, camera: Camera, state: tuple, contour: Any, support: Any) -> Drawing:
    nodes, pulls, _ = state
    if isinstance(given, Snake):
        first = np.concatenate([given.points, given.points[:1]]) if given.closed else given.points
        return Drawing((), contour, support, first, line=True, pulls=pulls)
    wires = [camera.project(line) for line in grid_lines(nodes)]
    return Drawing(wires, contour, support, pulls=pulls)


def _record(result: Result, names: list[str]) -> dict[str, Any]:
    scene, settings = result.scene, dataclasses.asdict(result.settings)
    unit = scene.units
    objects = {}
    for tube, o in zip(scene.tubes, result.objects, strict=True):
        objects[o.name] = {
            "kind": "tube",
            "converged": o.converged,
            "trusted": o.trusted,
            "warnings": o.warnings,
            "iterations": o.iterations,
            **o.measures,
            "grid": tube.grid,
            "material": {f.name: getattr(tube.material, f.name) for f in dataclasses.fields(tube.material)},
            "break": [dataclasses.asdict(b) for b in tube.breaks],
        }
    for given, o in zip(scene.lines, result.lines, strict=True):
        objects[o.name] = {
            "kind": o.kind,
            "converged": o.converged,
            "trusted": o.trusted,
            "warnings": o.warnings,
            "iterations": o.iterations,
            **o.measures,
            "grid": o.nodes.shape[1:-1],
            "material": dataclasses.asdict(given.material),
        }
    return plain(
        {
            "run": {
                "scene": scene.name,
                "source": scene.source,
                "written": datetime.now(UTC).isoformat(timespec="seconds"),
                "device": result.device,
                "image": {"width": scene.views[0].image.shape[1], "height": scene.views[0].image.shape[0]},
                "camera": scene.views[0].camera.matrix,
            },
            "versions": {
                "symseek": __version__,
                "python": platform.python_version(),
                **versions(),
                "opengl": os.environ.get("PYOPENGL_PLATFORM", ""),
            },
            "settings": settings,
            "forms": {key: FORMS[value] for key, value in settings.items() if isinstance(value, str) and value in FORMS},
            "units": {
                "world": unit,
                "scale": f"{scene.scale:g} {unit} per pixel" if scene.views[0].camera.affine else "by the camera",
                "length": unit,
                "station": unit,
                "radius": unit,
                "area": f"{unit}^2",
                "volume": f"{unit}^3",
                "contour_residual_px": "pixels of the image",
                "asymmetry": "share of the radius",
                "supported_share": "share of the contour's length that is not hidden",
                "hidden_share": "share of the contour's length",
                "map_agreement": "share of silhouette or map",
                "map_certainty": "share of the map",
                "partial": "whether an end lies beyond the image",
                "depth": unit,
                "depth_certainty": "0 to 1",
            },
            "seconds": {name: round(s, 4) for name, s in result.seconds.items()},
            "objects": objects,
            "skipped": result.skipped,
            "files": names,
        }
    )


def plain(value: Any) -> Any:
    """A value as JSON knows it: arrays as lists, what is not finite as null, a function as that word."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if callable(value):
        return "function"
    return value
