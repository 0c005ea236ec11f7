"""The files of a moving scene: table and plot over time, animated meshes, the film."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import KDTree

from .frames import together
from .render.animation import write_animated_glb, write_usd
from .render.figures import chart
from .render.files import write_picture
from .render.lines import Colour
from .render.overlay import Drawing, Photo, draw, line_width
from .render.platform import RenderError
from .render.raster import Renderer, Viewpoint, bounding_sphere
from .render.video import write_mp4
from .sim.beyond import between, places
from .sim.camera import Camera
from .sim.measure import arc_length
from .sim.problem import Tube
from .sim.result import ObjectResult
from .sim.surface import occluding_contour, refine, volume_and_area, wire

if TYPE_CHECKING:
    from .pipeline import Result

PANEL = (480, 360)
"""Size of each of the film's four pictures [px]."""
AROUND, ROWS = 48, 3
"""Vertices around and rows a ring of animated meshes."""
SIDES = ((35.0, 14.0), (125.0, 14.0))
"""Azimuth and elevation of the film's two other viewpoints [degrees]."""


def frame_meshes(o: ObjectResult) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (F, V, 3) and faces of an object's mesh in each frame."""
    meshes = [refine(tube, AROUND, ROWS * tube.shape[1], o.cuts) for tube in o.tube]
    return np.stack([vertices for vertices, _ in meshes]), meshes[0][1]


def write_motion(result: Result, o: ObjectResult, folder: Path, colour: Colour) -> None:
    """OBJECT.csv, OBJECT_time.png, an animated OBJECT.glb and, where usd-core is installed, OBJECT.usdc."""
    from .scene import METRES

    scene = result.scene
    vertices, faces = frame_meshes(o)
    length = np.array([arc_length(spine)[-1] for spine in o.spine])
    radius = np.linalg.norm(o.tube - o.spine[:, None], axis=3).mean(axis=1).max(axis=1)
    volume = np.array([volume_and_area(v, faces)[0] for v in vertices])
    speed = np.linalg.norm(o.velocity, axis=3).reshape(len(o.tube), -1)
    unit, rate = scene.units, "s" if scene.tracking.fps else "frame"
    columns = {
        f"length_{unit}": length,
        f"volume_{unit}3": volume,
        f"largest_radius_{unit}": radius,
        f"mean_speed_{unit}_per_{rate}": speed.mean(axis=1),
        f"largest_speed_{unit}_per_{rate}": speed.max(axis=1),
    }
    for name, at in (("first", 0), ("middle", o.spine.shape[1] // 2), ("last", -1)):
        columns |= {f"{name}_{axis}_{unit}": o.spine[:, at, i] for i, axis in enumerate("xyz")}
    with (folder / f"{o.name}.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", f"time_{rate}", *columns, "note"])
        for i, row in enumerate(zip(o.time, *columns.values(), strict=True)):
            table.writerow([i, *(f"{v:.6g}" for v in row), o.notes[i]])
    shown = [(name.replace("_", " "), columns[name]) for name in list(columns)[:4]]
    write_picture(folder / f"{o.name}_time.png", chart(o.time, shown, f"time [{rate}]"))
    metres = METRES[unit]
    write_animated_glb(folder / f"{o.name}.glb", vertices, faces, o.time, metres, colour, o.name)
    try:
        write_usd(folder / f"{o.name}.usdc", vertices, faces, scene.tracking.fps or 24.0, metres, colour, o.name)
    except ImportError as problem:
        result.skipped[f"{o.name}.usdc"] = f"{problem}: pip install symseek[usd]"


def write_film(result: Result, path: Path) -> None:
    """Each frame beside the model over it, and the model from two other sides, coloured by its speed."""
    fps = result.scene.tracking.fps or result.scene.output.video_fps
    try:
        write_mp4(path, _film(result), fps)
    except RenderError as problem:
        result.skipped[path.name] = str(problem)


def _film(result: Result) -> Iterator[np.ndarray]:
    from .files import front

    scene, objects = result.scene, result.objects
    camera = scene.views[0].camera
    meshes = [frame_meshes(o) for o in objects]
    centre, radius = bounding_sphere(*(v.reshape(-1, 3) for v, _ in meshes))
    sides = [Viewpoint(centre, radius, a, e, front(camera, centre)) for a, e in SIDES]
    count = len(objects[0].tube)
    most = max(float(np.quantile(np.linalg.norm(o.velocity, axis=3), 0.995)) for o in objects)
    with Renderer(*PANEL) as renderer:
        for i, images in zip(range(count), together(scene.frames), strict=False):
            shown = np.zeros((*scene.views[0].image.shape[:2], 3)) if isinstance(images, str) else images[0]
            photo = Photo(shown, PANEL)
            over = photo.picture.copy()
            drawings = []
            for tube, o in zip(scene.tubes, objects, strict=True):
                lines = [camera.project(line) for line in wire(o.tube[i], cuts=o.cuts)]
                contour = [points for points, _ in occluding_contour(o.tube[i], camera, o.cuts)]
                there = not o.notes[i].startswith("lost")
                guessed = [past_ends(tube, o, i, camera, c) for c in contour]
                drawings.append(Drawing(lines, contour, [np.full(len(c), there) for c in contour], hidden=guessed))
            for drawing in drawings:
                draw(over, photo, drawing, line_width(photo, drawings))
            solid = [
                (vertices[i], faces, _by_speed(vertices, i, most / (scene.tracking.fps or 1.0)))
                for vertices, faces in meshes
            ]
            low = [renderer.shade(solid, side) for side in sides]
            yield np.concatenate([np.concatenate([photo.picture, over], axis=1), np.concatenate(low, axis=1)], axis=0)


def past_ends(tube: Tube, o: ObjectResult, i: int, camera: Camera, points: np.ndarray) -> np.ndarray:
    """Which image points (n, 2) of frame i's contour lie past ends at which the object goes on, where nothing is known."""
    out = np.zeros(len(points), bool)
    if any(tube.goes_on):
        start = o.spine[0] if tube.spine.shape[1] == 3 else camera.project(o.spine[0])
        ends = places(start, tube.spine[[0, -1]])
        place = np.linspace(0, o.spine.shape[1] - 1, 400)
        place = place[KDTree(camera.project(between(o.spine[i], place))).query(points)[1]]
        out |= (tube.goes_on[0] & (place < ends[0])) | (tube.goes_on[1] & (place > ends[1]))
    return out


def _by_speed(vertices: np.ndarray, i: int, most: float) -> np.ndarray:
    """Colour of each vertex by its way from frame to frame, from blue (at rest) to red (`most`), uint8 (V, 3)."""
    a, b = max(i - 1, 0), min(i + 1, len(vertices) - 1)
    way = np.linalg.norm(vertices[b] - vertices[a], axis=1) / max(b - a, 1)
    t = np.clip(way / max(most, 1e-12), 0, 1)[:, None]
    stops = np.array([[58, 110, 190], [90, 185, 150], [240, 210, 90], [215, 70, 50]], float)
    k = np.minimum((t * 3).astype(int), 2)
    return np.round(stops[k[:, 0]] + (3 * t - k) * (stops[k[:, 0] + 1] - stops[k[:, 0]])).astype(np.uint8)
