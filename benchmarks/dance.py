"""The dance: silhouettes against the picture, each part's visible outline, figures, the turning film, growth with tubes.

`python -m benchmarks.dance [--quick] [--out FILE.md]` solves the scene `dance` as it ships and light on dark, and a
picture that is not ours (rites.toml) if SYMSEEK_DATA names the folder that holds it; then 1, 43, 430 and 4300 tubes, copies
of the scene laid side by side, each in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from skimage import measure

import symseek
from symseek.cli import demos
from symseek.device import start_quietly
from symseek.files import COLOURS
from symseek.render.stages import turning_frames
from symseek.render.video import write_mp4
from symseek.scenes import raster
from symseek.scenes.broken import joined
from symseek.sim.figure import figures
from symseek.sim.reconstruct import reconstruct
from symseek.sim.result import ObjectResult
from symseek.sim.surface import refine

from .photographs import here
from .tables import Headed, command, headed, machine

COUNTS = (1, 43, 430, 4300)
PART = 43
"""Tubes of a copy."""
TILES = {1: (1, 1), 43: (1, 1), 430: (5, 2), 4300: (10, 10)}
"""Copies side by side and one above the other."""
FRAMES, EARLY = 400, 50


def dance() -> symseek.Scene:
    """The scene as it ships: dark on light."""
    return symseek.load(demos()["dance"])


def inverted(scene: symseek.Scene) -> symseek.Scene:
    """Light on dark."""
    scene.views = [replace(scene.views[0], image=1 - scene.views[0].image)]
    return scene


def scenes() -> dict[str, tuple[symseek.Scene, np.ndarray]]:
    """Each with its ink, the share of each pixel that figures cover, shape (H, W)."""
    found = {"dark on light": dance(), "light on dark": inverted(dance())}
    inks = [1 - found["dark on light"].views[0].image] * 2
    if here():
        found["rites, not ours"] = symseek.load(Path(__file__).parent / "rites.toml")
        inks.append(1 - found["rites, not ours"].views[0].image)
    return dict(zip(found, zip(found.values(), inks, strict=True), strict=True))


def silhouette(objects: Sequence[ObjectResult], shape: tuple[int, int]) -> np.ndarray:
    """Share of each pixel that tubes cover together, shape (H, W)."""
    vertices, faces = joined(*((o.vertices, o.faces) for o in objects))
    return raster.coverage(vertices[:, :2], faces, shape, samples=4)


def visible_outlines(objects: Sequence[ObjectResult], ink: np.ndarray) -> list[tuple[float, float, float]]:
    """For each tube: share of its contour that no other covers; there, mean and 95 % distance to the ink's outline [px]."""
    edge = cKDTree(np.concatenate(measure.find_contours(ink, 0.5))[:, ::-1])
    covers = [silhouette([o], ink.shape[:2]) > 0.5 for o in objects]
    count = np.sum(covers, axis=0, dtype=np.int16)
    found = []
    for o, own in zip(objects, covers, strict=True):
        points = np.concatenate(o.contour)
        others = (count - own).astype(np.float32)
        free = map_coordinates(others, points[:, ::-1].T, order=1, mode="constant") < 0.5
        away = edge.query(points[free])[0] if free.any() else np.array([np.nan])
        found.append((float(free.mean()), float(away.mean()), float(np.percentile(away, 95))))
    return found


def quality(scene: symseek.Scene, ink: np.ndarray) -> tuple[dict[str, str], list[list[str]], list[ObjectResult]]:
    """Figures of the whole, a row for each part, and the tubes."""
    began = time.perf_counter()
    found = reconstruct(scene.views, scene.tubes, scene.settings)
    seconds = time.perf_counter() - began
    solids = figures(scene.tubes, found.objects)
    cover = silhouette(found.objects, ink.shape[:2])
    parts = visible_outlines(found.objects, ink)
    closed = [trimesh.Trimesh(s.vertices, s.faces, process=False).is_watertight for s in solids]
    mean = np.array([m for _, m, _ in parts])
    whole = {
        "tubes": f"{len(found.objects)}",
        "IoU of the union with the picture": f"{np.minimum(cover, ink).sum() / np.maximum(cover, ink).sum():.4f}",
        "visible outlines to the ink's, px: median part, worst": f"{np.nanmedian(mean):.2f}, {np.nanmax(mean):.2f}",
        "figures watertight": f"{sum(closed)} of {len(solids)}",
        "figures in one piece": f"{sum(len(s.pieces) == 1 for s in solids)} of {len(solids)}",
        "tubes trusted": f"{sum(o.trusted for o in found.objects)}",
        "tubes at rest": f"{sum(o.converged for o in found.objects)}",
        "seconds": f"{seconds:.1f}",
    }
    rows = [
        [o.name, f"{free:.0%}", f"{m:.2f}", f"{most:.2f}", f"{o.iterations}", "yes" if o.trusted else "no"]
        for o, (free, m, most) in zip(found.objects, parts, strict=True)
    ]
    return whole, rows, found.objects


def turn(objects: Sequence[ObjectResult], frames: int) -> tuple[float, float]:
    """Seconds a frame of the turning film, and memory at its end over that after `EARLY` frames."""
    meshes = [(*refine(o.tube[0], 24, 28), COLOURS[k % len(COLOURS)]) for k, o in enumerate(objects)]
    held = []

    def watched():
        for k, frame in enumerate(turning_frames(meshes, frames=frames)):
            if k in (EARLY, frames - 1):
                held.append(int(Path("/proc/self/statm").read_text().split()[1]))
            yield frame

    began = time.perf_counter()
    with TemporaryDirectory() as folder:
        write_mp4(Path(folder) / "turning.mp4", watched(), 30)
    return (time.perf_counter() - began) / frames, held[1] / held[0]


def repeated(count: int) -> symseek.Scene:
    """`count` tubes: the first `PART` of the scene, or fewer, in copies side by side."""
    scene, (across, down) = dance(), TILES[count]
    h, w = scene.views[0].image.shape[:2]
    places = [np.array([w * i, h * j], float) for j in range(down) for i in range(across)]
    chosen = scene.tubes[: min(count, PART)]
    scene.tubes = [
        replace(tube, spine=tube.spine + place, name=f"{tube.name}_{k}") for k, place in enumerate(places) for tube in chosen
    ]
    scene.views = [replace(scene.views[0], image=np.tile(scene.views[0].image, (down, across)))]
    return scene


def growth(count: int) -> dict[str, float]:
    """Seconds by the clock and of CPU and peak memory [MB] of `count` tubes in a process of their own, and memory before."""
    text = f"from benchmarks.dance import alone; alone({count})"
    # glibc would keep a third more in holes
    tight = os.environ | {"MALLOC_MMAP_THRESHOLD_": "2000000", "MALLOC_ARENA_MAX": "2"}
    done = subprocess.run([sys.executable, "-c", text], check=True, capture_output=True, text=True, env=tight)
    return json.loads(done.stdout.splitlines()[-1])


def alone(count: int) -> None:
    """Prints what `growth` reads."""
    start_quietly()
    scene = dance()
    reconstruct(scene.views, scene.tubes[:1], replace(scene.settings, iterations=20))  # kernels and libraries
    scene = repeated(count)
    before = _peak()
    began, spent = time.perf_counter(), time.process_time()
    found = reconstruct(scene.views, scene.tubes, scene.settings)
    took = {"seconds": time.perf_counter() - began, "cpu": time.process_time() - spent}
    print(json.dumps({**took, "before": before, "peak": _peak(), **found.seconds}))


def _peak() -> float:
    """MB; getrusage would hand on the parent's."""
    status = Path("/proc/self/status").read_text()
    return float(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))) / 1024


def measure_all(quick: bool) -> Headed:
    """Headings and tables, head first."""
    found = {name: quality(scene, ink) for name, (scene, ink) in scenes().items()}
    _, rows, objects = found["dark on light"]
    columns = [whole for whole, _, _ in found.values()]
    whole = [["", *found], *([key, *(column[key] for column in columns)] for key in columns[0])]
    each, grown = turn(objects, 100 if quick else FRAMES)
    film = [["frames", "seconds each", f"memory at the end over that of frame {EARLY}"]]
    film.append([f"{100 if quick else FRAMES}", f"{each:.3f}", f"{grown:.3f}"])
    table = [["tubes", "seconds", "each", "CPU seconds each", "maps", "solve", "peak MB", "more a tube"]]
    for count in COUNTS[: 2 if quick else None]:
        g = growth(count)
        table.append([f"{count}", f"{g['seconds']:.1f}", f"{g['seconds'] / count:.3f}", f"{g['cpu'] / count:.3f}"])
        table[-1] += [f"{g['map']:.1f}", f"{g['solve']:.1f}", f"{g['peak']:.0f}", f"{(g['peak'] - g['before']) / count:.2f}"]
    head = ["part", "contour seen", "to the outline, mean px", "95 %", "iterations", "trusted"]
    return [
        ("The whole", whole),
        ("Each part's visible outline", [head, *rows]),
        ("The turning film", film),
        ("Growth with the number of tubes", table),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    def run(quick: bool) -> Callable[[bool], str]:
        on, tables = machine(), measure_all(quick)
        return lambda markdown: headed(tables, on, markdown)

    return command(arguments, "dance", "The dance.", "up to 43 tubes and 100 frames only", run)


if __name__ == "__main__":
    sys.exit(main())
