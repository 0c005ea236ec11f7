"""The files of a run: record, meshes, arrays, pictures and video."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .folder import RECORD
from .motion import write_film, write_motion
from .record import record_of
from .render.evolution import Snapshot, evolution_frames
from .render.export import write_glb, write_ply
from .render.figures import potentials_sheet, views_sheet
from .render.files import write_picture
from .render.lines import Colour
from .render.overlay import SUPPORTED, Drawing, draw_overlay, side_by_side
from .render.platform import RenderError
from .render.stages import Stage, stages_sheet, turning_frames
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
SNAPSHOTS, STATES = (12, 90), 2000
"""Bounds of how many states of the deformation the video shows; of all objects together."""
ASTRAY = "the model has grown out of the image"


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
    phase("pictures", "rendering the video ..." if want.video or want.turning else "")
    if want.video:
        (write_film if result.scene.frames else _write_video)(result, folder / "reconstruction.mp4")
    if want.turning and result.objects:
        _write_turning(result, folder / "turning.mp4")
    if want.video or want.turning:
        phase("video", "")
    names = [RECORD, *sorted(f.name for f in folder.iterdir())]
    text = json.dumps(record_of(result, names), indent=1, ensure_ascii=False, allow_nan=False)
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
            time=o.time,
            units=np.array(scene.units),
        )
        if result.scene.frames:
            write_motion(result, o, folder, colour)
    for figure, colour in zip(result.figures, _colours(), strict=False):
        mesh(figure.name, figure.vertices, figure.faces, colour)
    for o, colour in zip(result.lines, _colours(len(result.objects)), strict=False):
        if o.kind == "sheet":
            mesh(o.name, *sheet_mesh(o.nodes[0]), colour)
        units = np.array("px" if o.kind == "snake" else scene.units)
        arrays = {("curve" if o.kind == "snake" else o.kind): o.nodes, "time": np.zeros(len(o.nodes)), "units": units}
        np.savez_compressed(folder / f"{o.name}.npz", **arrays)


def _write_pictures(result: Result, folder: Path) -> None:
    want, view = result.scene.output, result.scene.views[0]
    solid = [*result.objects, *(o for o in result.lines if o.kind == "sheet")]
    astray = not all(_in_reach(v, o, -1) for v in result.scene.views for o in result.objects)
    astray |= not all(_in_reach(view, o, -1) for o in result.lines)
    lost = {"overlay": want.overlay and astray, "views": want.views and astray and bool(solid)}
    result.skipped |= {f"{name}.png": ASTRAY for name, left_out in lost.items() if left_out}
    if want.overlay and not astray:
        write_picture(folder / "overlay.png", side_by_side([_overlay(result, v) for v in range(len(result.scene.views))]))
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
            for line in (wire(o.tube[-1], cuts=o.cuts) if isinstance(o, ObjectResult) else grid_lines(o.nodes[0]))
        ]
        try:
            write_picture(folder / "views.png", views_sheet(meshes, wires, _front(result)))
        except RenderError as problem:
            result.skipped["views.png"] = str(problem)

    several = len(result.objects) > 1 if want.stages is None else want.stages and bool(result.objects)
    if several:
        if not all(_in_reach(view, o, i) for o in result.objects for i in (0, -1)):
            result.skipped["stages.png"] = ASTRAY
            return
        try:
            write_picture(folder / "stages.png", stages_sheet(view.image, _stages(result), _front(result)))
        except RenderError as problem:
            result.skipped["stages.png"] = str(problem)


def _stages(result: Result) -> list[Stage]:
    camera, stages = result.scene.views[0].camera, []
    for tube, o, colour in zip(result.scene.tubes, result.objects, _colours(), strict=False):
        given = tube.spine if tube.spine.shape[1] == 2 else camera.project(tube.spine)
        found = camera.project(o.spine[0])
        stages.append(Stage(colour, given, found, _mesh(o, 0), _mesh(o, -1), wire(o.tube[0], cuts=o.cuts)))
    return stages


def _write_turning(result: Result, path: Path) -> None:
    if not all(_in_reach(result.scene.views[0], o, -1) for o in result.objects):
        result.skipped[path.name] = ASTRAY
        return
    count = len(result.objects)
    meshes = [(*_mesh(o, -1, count), colour) for o, colour in zip(result.objects, _colours(), strict=False)]
    try:
        write_mp4(path, turning_frames(meshes, _front(result)), result.scene.output.video_fps)
    except RenderError as problem:
        result.skipped[path.name] = str(problem)


def _overlay(result: Result, v: int) -> np.ndarray:
    """View v with all tubes over it, and what is no tube over the first."""
    view, several = result.scene.views[v], len(result.scene.views) > 1
    drawings = [
        _drawing(
            tube if len(o.tube) == 1 and (v == 0 or tube.spine.shape[1] == 3) else None,  # given in the first frame
            view.camera, o.tube[-1], o.spine[-1], o.seen[v].contour, o.seen[v].support, o.cuts, o.seen[v].hidden, colour,
        )
        for tube, o, colour in zip(result.scene.tubes, result.objects, _contours(result), strict=False)
    ]  # fmt: skip
    drawings += [
        _line_drawing(given, view.camera, o.history[-1], o.contour, o.support)
        for given, o in zip(result.scene.lines, result.lines, strict=True)
        if v == 0
    ]
    return draw_overlay(view.image, drawings, legend=v == 0, caption=view.name if several else "")


def _write_video(result: Result, path: Path) -> None:
    view, fps = result.scene.views[0], result.scene.output.video_fps
    objects = [*result.objects, *result.lines]
    # a run that went astray may have states that no picture can hold
    fit = [[i for i in range(len(o.history)) if _in_reach(view, o, i)] for o in objects]
    if not all(fit):
        result.skipped[path.name] = ASTRAY
        return
    count = min(max(map(len, fit)), int(np.clip(STATES // len(objects), *SNAPSHOTS)))
    shown = zip(*(np.array(i)[np.rint(np.linspace(0, len(i) - 1, count)).astype(int)] for i in fit), strict=True)
    snapshots = [_snapshot(result, states) for states in shown]
    try:
        write_mp4(path, evolution_frames(view.image, snapshots, COLOURS, fps, front=_front(result)), fps)
    except RenderError as problem:
        result.skipped[path.name] = str(problem)


def _colours(first: int = 0) -> Iterator[Colour]:
    """Colours of objects, in turn."""
    return itertools.islice(itertools.cycle(COLOURS), first, None)


def _contours(result: Result) -> Iterator[Colour]:
    """Colours of contours: of objects, in turn, where there are several."""
    return _colours() if len(result.objects) > 1 else itertools.repeat(SUPPORTED)


def _front(result: Result) -> np.ndarray:
    """`front` at the middle of the first object that lies in the world; at its origin where all are snakes."""
    places = [o.spine[-1] for o in result.objects] + [o.nodes[0] for o in result.lines if o.kind == "sheet"]
    middle = places[0].reshape(-1, 3).mean(axis=0) if places else np.zeros(3)
    return front(result.scene.views[0].camera, middle)


def _in_reach(view: View, o: ObjectResult | LineResult, i: int) -> bool:
    """Whether state i of an object can be drawn."""
    nodes = o.history[i][0]
    return in_reach(View(view.image) if isinstance(o, LineResult) and o.kind == "snake" else view, nodes)


def _mesh(o: ObjectResult | LineResult, i: int, count: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Mesh of state i of a tube, or of a sheet with both its sides, to be shaded; coarser for a film of many objects."""
    if isinstance(o, LineResult):
        vertices, faces = sheet_mesh(o.history[i][0])
        return np.concatenate([vertices, vertices]), np.concatenate([faces, faces[:, ::-1] + len(vertices)])
    nodes, _, _, cuts = o.history[i]
    if i == -1 and not count:
        return o.vertices, o.faces
    around = max(24, 2 * round(32 / max(count, 1) ** 0.25))
    return refine(nodes, around, 3 * nodes.shape[1] * around // 64, cuts)


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
    given_objects = [*result.scene.tubes, *result.scene.lines]
    for given, o, i, colour in zip(given_objects, objects, states, _contours(result), strict=False):
        if isinstance(o, LineResult):
            assert not isinstance(given, Tube)
            drawings.append(_line_drawing(given, camera, o.history[i], [outline(given, o.history[i][0], camera)], ()))
        else:
            assert isinstance(given, Tube)
            nodes, spine, _, cuts = o.history[i]
            contour = [points for points, _ in occluding_contour(nodes, camera, cuts)]
            drawings.append(_drawing(given, camera, nodes, spine, contour, (), cuts, colour=colour))
    solid = [(o, i) for o, i in zip(objects, states, strict=True) if not isinstance(o, LineResult) or o.kind == "sheet"]
    meshes = [_mesh(o, i, len(objects)) for o, i in solid]
    return Snapshot(drawings, meshes, f"sigma {objects[0].history[states[0]][2]:.3g} px")


def _drawing(
    tube: Tube | None,
    camera: Camera,
    nodes: np.ndarray,
    spine: np.ndarray,
    contour: Any,
    support: Any,
    cuts: Sequence[Cut],
    hidden: Sequence[np.ndarray] = (),
    colour: Colour = SUPPORTED,
) -> Drawing:
    given = None if tube is None else tube.spine if tube.spine.shape[1] == 2 else camera.project(tube.spine)
    wires = [camera.project(line) for line in wire(nodes, cuts=cuts)]
    return Drawing(wires, contour, support, given, camera.project(spine), hidden=hidden, colour=colour)


def _line_drawing(given: Snake | Sheet, camera: Camera, state: tuple, contour: Any, support: Any) -> Drawing:
    nodes, pulls, _ = state
    if isinstance(given, Snake):
        first = np.concatenate([given.points, given.points[:1]]) if given.closed else given.points
        return Drawing((), contour, support, first, line=True, pulls=pulls)
    wires = [camera.project(line) for line in grid_lines(nodes)]
    return Drawing(wires, contour, support, pulls=pulls)
