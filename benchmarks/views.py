"""Pairs of eyes and rings of views: depth, surface, volume and silhouettes against the truth, beside the visual hull.

`python -m benchmarks.views [--quick] [--out FILE.md]`. Defaults, axes clicked in two views with 4 px of error. The constants
of several views were chosen on seeds below 200. The hull gets the true masks and the true bounding box.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from symseek.scenes import views as generator
from symseek.scenes.shapes import KINDS
from symseek.scenes.views import Views
from symseek.sim.problem import Tube, View
from symseek.sim.reconstruct import reconstruct
from symseek.sim.sights import triangulated

from . import tables, truth

SEEDS = range(31031, 31053)
"""Two solids of each kind."""
LUMPY = 0.05
"""Amplitude of the second and third harmonic of sections out of round."""
CELLS = 128
"""Of the hull, along each side of the bounding box."""
MARGIN = 0.02
BETWEEN = 50
"""Points of a spine's curve between two nodes: where it is steep, those alone would be off by their spacing."""


@dataclass(frozen=True)
class Score:
    """Of one method on one solid; lengths in % of the axis."""

    surface: float
    volume: float
    """signed [%]."""
    iou: float
    """least of all views."""
    depth: float
    """mean over the true axis, by its length, of how far the spine there lies along Z; nan without one."""
    seconds: float
    """of CPU."""
    trusted: bool = True


def surface_distance(vertices: np.ndarray, faces: np.ndarray, made: Views, count: int = 6000) -> float:
    """Mean distance between a mesh and the true one, both ways, nothing shifted [% of the axis]."""
    there = truth.to_surface(truth.spread_over(vertices[faces].astype(float), count), (made.vertices, made.faces))
    back = truth.to_surface(truth.spread_over(made.vertices[made.faces].astype(float), count), (vertices, faces))
    return 50 * float(there.mean() + back.mean()) / made.length


def score(
    made: Views, vertices: np.ndarray, faces: np.ndarray, spine: np.ndarray | None, seconds: float, trusted: bool
) -> Score:
    """Errors of a mesh, and of a spine (n, 3) if there is one."""
    depth = float("nan")
    if spine is not None:
        found = CubicSpline(np.arange(len(spine)), spine)(np.linspace(0, len(spine) - 1, BETWEEN * (len(spine) - 1) + 1))
        near = KDTree(found[:, :2]).query(made.spine[:, :2])[1]
        depth = 100 * float(np.abs(found[near, 2] - made.spine[:, 2]).mean()) / made.length
    pairs = zip(made.cameras, made.coverages, strict=True)
    iou = min(truth.silhouette_iou(vertices, faces, camera, cover) for camera, cover in pairs)
    volume = truth.volume_error(vertices, faces, made.volume)
    return Score(surface_distance(vertices, faces, made), volume, iou, depth, seconds, trusted)


def ours(made: Views) -> Score:
    began, second = time.process_time(), max(1, len(made.cameras) // 4)
    rough = triangulated([made.clicks[v] for v in (0, second)], [made.cameras[v] for v in (0, second)])
    views = [View(i, c, f"view{v}") for v, (i, c) in enumerate(zip(made.images, made.cameras, strict=True))]
    found = reconstruct(views, [Tube(rough)]).objects[0]
    seconds = time.process_time() - began
    return score(made, found.vertices, found.faces, found.spine[0], seconds, found.trusted)


def hull(made: Views) -> Score:
    """All that no mask excludes, on a grid, its surface by marching cubes between the cells."""
    began = time.process_time()
    low, high = made.vertices.min(axis=0), made.vertices.max(axis=0)
    low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
    axes = [np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.full(len(grid), np.inf)
    for camera, cover in zip(made.cameras, made.coverages, strict=True):
        mask = cover >= 0.5
        away = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
        away = np.where((cover > 0) & (cover < 1), cover - 0.5, away - 0.5 * np.sign(away))
        inside = np.minimum(inside, ndimage.map_coordinates(away, camera.project(grid).T[::-1], order=1, mode="nearest"))
    step = (high - low) / (CELLS - 1)
    vertices, faces, _, _ = marching_cubes(inside.reshape((CELLS,) * 3), 0.0, spacing=tuple(step))
    vertices, faces = vertices + low, faces.astype(int)
    if truth.volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    return score(made, vertices, faces, None, time.process_time() - began, True)


def lots() -> dict[str, Callable[[int], Views]]:
    """What is rendered for each seed, by heading."""
    out: dict[str, Callable[[int], Views]] = {
        "stereo (15)": generator.pair,
        "perspective pair": partial(generator.pair, perspective=True),
    }
    for amount, shapes in ((0.0, ""), (LUMPY, ", lumpy")):
        for perspective, kind in ((False, "affine"), (True, "perspective")):
            for count in (3, 8, 24):
                out[f"ring of {count}, {kind}{shapes}"] = partial(
                    generator.ring, count=count, perspective=perspective, out_of_round=amount
                )
    return out


def row(name: str, scores: Sequence[Score]) -> list[str]:
    """Medians, and the worst in brackets."""
    surface, volume, iou, depth, seconds = (
        np.array([getattr(s, key) for s in scores]) for key in ("surface", "volume", "iou", "depth", "seconds")
    )
    deep = "-" if np.isnan(depth).any() else f"{np.median(depth):.2f} ({depth.max():.2f})"
    return [
        name, f"{np.median(surface):.3f} ({surface.max():.2f})", f"{np.median(abs(volume)):.2f} ({abs(volume).max():.1f})",
        f"{np.median(iou):.4f} ({iou.min():.3f})", deep, f"{np.median(seconds):.2f}",
        str(sum(not s.trusted for s in scores)),
    ]  # fmt: skip


def measured(quick: bool) -> Callable[[bool], str]:
    """Solves all; returns what writes the tables."""
    on, seeds = tables.machine(), SEEDS[:: len(KINDS) // 2] if quick else SEEDS
    rows = [["", "3D %", "volume %", "least IoU", "depth %", "CPU s", "not trusted"]]
    for name, make in lots().items():
        if quick and "24" in name:
            continue
        done: dict[str, list[Score]] = {}
        for made in map(make, seeds):
            for method, solve in (("symseek", ours), ("visual hull", hull)):
                done.setdefault(method, []).append(solve(made))
        for method, scores in done.items():
            rows.append(row(f"{name}: {method}", scores))
            print("  ".join(rows[-1]), flush=True)
    titles = [(f"Several views, {len(seeds)} solids each: median (worst)", rows)]
    return lambda markdown: tables.headed(titles, on, markdown)


def main(arguments: Sequence[str] | None = None) -> int:
    return tables.command(
        arguments, "views", "Pairs and rings of views beside the visual hull.", "five solids, no rings of 24", measured
    )


if __name__ == "__main__":
    raise SystemExit(main())
