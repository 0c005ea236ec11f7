"""Still scenes of snakes and sheets: from rough curves and corners to rest, from coarse to fine scale."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from ..kernels import integrate
from ..kernels import sheet as sheet_kernels
from ..kernels import spring as spring_kernels
from .camera import Camera
from .curve import border, evenly, shoelace
from .measure import contour_support, support_measures
from .potential import RANGE, Potential
from .problem import Settings, Sheet, Snake, View
from .relax import CHECK, LOOK, REST, SNAPSHOTS, thinned
from .result import LEAST_SUPPORT, MOST_OUTSIDE
from .sheet import Sheets

COARSE = 10.0
"""How much more residual a coarse scale may keep."""
FINE = 8
"""Points of the smooth curve for each node, by which a snake is measured and drawn."""
SPACING = 0.5
"""Between points of the smooth curve whose support by the image is measured, at least [samples]."""
LOST = 1e3
"""Distance from its first place at which an object is lost [own units]."""


@dataclass
class LineResult:
    """One snake or sheet at rest."""

    name: str
    kind: str
    """"snake" or "sheet"."""
    nodes: np.ndarray
    """of a snake (1, n, 2), image points; of a sheet (1, N_x, N_s, 3), world units."""
    contour: list[np.ndarray]
    """the smooth outline in the first view, shape (m, 2), image px; of a closed one the first point again at the end."""
    support: list[np.ndarray]
    """for each piece, which points image data supports, shape (m,), bool."""
    measures: dict[str, Any]
    history: list[tuple[np.ndarray, list[np.ndarray], float]]
    """nodes (N_x, N_s, 3), springs that hold as segments (2, 2) of image points, sigma [px]; first state to last."""
    iterations: int = 0
    converged: bool = True
    trusted: bool = True
    warnings: list[str] = field(default_factory=list)


@dataclass
class Found:
    """What a run yields: objects, potentials of the first, seconds by phase."""

    objects: list[LineResult]
    potentials: list
    foreground: np.ndarray | None
    seconds: dict[str, float]
    settings: Settings


class Progress:
    """Where a run is; handed to the callback each iteration."""

    def __init__(self, scene: Sheets, stages: int):
        self._scene = scene
        self.iteration, self.total = 0, scene.settings.iterations
        self.stage, self.stages, self.sigma, self.residual = 0, stages, 0.0, float("inf")

    def nodes(self, k: int = 0) -> np.ndarray:
        """Nodes of object k now, shape (N_x, N_s, 3): of a snake image px, of a sheet world units."""
        return self._scene.world(k)


def deform(
    views: list[View],
    objects: list[Snake | Sheet],
    settings: Settings | None = None,
    device: str = "cpu",
    callback: Callable[[Any], bool | None] | None = None,
) -> Found:
    """Brings snakes and sheets to rest, from coarse to fine scale; springs take hold and let go on the way.

    The finest scale goes on until every spring has done its work. When one lets go there, the run goes back to a scale
    at which the image reaches what was pulled away.

    Args:
        views: the images; one for now.
        objects: rough curves and sheets.
        settings: of the solver.
        device: Warp device.
        callback: called each iteration; returning True stops the run.

    Returns:
        The objects with their measures.
    """
    settings = settings or Settings()
    clock, seconds = time.perf_counter(), {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[name] = seconds.get(name, 0.0) + now - clock
        clock = now

    scene = Sheets(views, objects, settings, device)
    lap("map")
    for module in (sheet_kernels, spring_kernels, integrate):
        wp.load_module(module, device=device)
    with wp.ScopedCapture(device=device, force_module_load=False) as capture:
        scene.iterate()
    assert capture.graph is not None
    lap("kernels")
    lists = [space.sigmas if space else [0.0] for space in scene.spaces]
    stages = max(len(x) for x in lists)
    progress = Progress(scene, stages)
    history: list[list] = [[] for _ in objects]
    sigmas_of = [[x[max(0, len(x) - stages + stage)] for x in lists] for stage in range(stages)]
    pool = ThreadPoolExecutor(os.cpu_count())
    ahead = [
        [s and pool.submit(s.at, sigma, stage == stages - 1) for s, sigma in zip(scene.spaces, sigmas, strict=True)]
        for stage, sigmas in enumerate(sigmas_of)
    ]
    pool.shutdown(wait=False)
    potentials: list[list[Potential | None]] = []
    stopped = converged = diverged = False
    stage, again = 0, None
    held = scene.node.numpy().copy()
    while stage < stages and not (stopped or diverged):
        sigmas = sigmas_of[stage]
        finest = stage == stages - 1
        if progress.iteration > 0:
            scene.deal()
        if stage == len(potentials):
            potentials.append([one and one.result() for one in ahead[stage]])
        scene.set_potentials(potentials[stage])
        lap("potential")
        progress.stage, progress.sigma = stage, sigmas[0]
        start, begun, before, moved = scene.node.numpy().copy(), progress.iteration, scene.node.numpy().copy(), np.inf
        tolerance = settings.tolerance * (1.0 if finest else COARSE)
        end = progress.iteration + (settings.iterations - progress.iteration) // (stages - stage)
        converged, again = False, None
        while progress.iteration < end and not (converged or stopped or diverged or again is not None):
            if scene.springs.due(progress.iteration):
                now = scene.node.numpy().copy()
                if finest and scene.springs.lets_go(progress.iteration):
                    again = _stage_that_reaches(scene, lists, now - held)
                scene.springs.set(progress.iteration, now)
                scene.set_material()
                held, before, begun, moved = now, now, progress.iteration, np.inf
            if progress.iteration % max(CHECK, settings.iterations // (10 * SNAPSHOTS)) == 0:
                for k in range(len(objects)):
                    history[k].append((scene.world(k), scene.pulls(k), sigmas[k]))
            wp.capture_launch(capture.graph)
            progress.iteration += 1
            if finest and (progress.iteration - begun) % LOOK == 0:
                moved = float(np.linalg.norm(scene.node.numpy() - before, axis=1).max())
                before = scene.node.numpy().copy()
            if progress.iteration % CHECK == 0 or progress.iteration == end:
                progress.residual = scene.residual()
                at_rest = progress.residual < tolerance and (not finest or moved < REST)
                converged = at_rest and not (finest and scene.springs.pending(progress.iteration))
                if not np.abs(scene.node.numpy()).max() < LOST:
                    scene.rewind(start)
                    diverged = True
            stopped = bool(callback and callback(progress))
        stage = stage + 1 if again is None else again
        lap("solve")
    for one in (one for made in ahead[len(potentials) :] for one in made):
        _ = one and one.cancel()
    results = []
    for k in range(len(objects)):
        history[k].append((scene.world(k), scene.pulls(k), progress.sigma))
        results.append(
            _finish(scene, k, potentials[progress.stage][k], thinned(history[k]), progress.iteration, converged, diverged)
        )
    lap("measure")
    h, w = views[0].image.shape[:2]
    pictures = [p[0].picture for p in potentials if p[0] is not None]
    first = scene.spaces[0]
    foreground = first.map.in_image((h, w)) if first and first.settings.potential == "map" else None
    return Found(results, pictures, foreground, seconds, settings)


def _stage_that_reaches(scene: Sheets, lists: list[list[float]], moved: np.ndarray) -> int:
    """The finest stage at which the image still reaches what springs have pulled away, by `moved` (N, 3) [own units]."""
    stages = max(len(x) for x in lists)
    found = stages - 1
    for k, sigmas in enumerate(lists):
        way = float(np.linalg.norm(moved[scene.nodes_of(k)], axis=1).max()) / scene.pixel(k)
        reaching = [i for i, sigma in enumerate(sigmas) if RANGE * sigma >= way]
        found = min(found, stages - len(sigmas) + max(reaching, default=0))
    return found


def _finish(
    scene: Sheets, k: int, potential: Potential | None, history: list, iterations: int, converged: bool, diverged: bool
) -> LineResult:
    """Measures object k as it is now, and says what speaks against it."""
    o, space, nodes = scene.objects[k], scene.spaces[k], scene.world(k)
    scale = 1 / float(np.linalg.norm(scene.views[0].camera.matrix[0, :3])) if scene.views[0].camera.affine else 1.0
    line = outline(o, nodes, scene.views[0].camera)
    closed = isinstance(o, Sheet) or o.closed
    measures: dict[str, Any] = {"area": sheet_area(nodes)} if isinstance(o, Sheet) else {}
    if isinstance(o, Snake):
        measures["length"] = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) * scale
        if closed:
            measures["area"] = shoelace(line[:-1]) * scale**2
    flags, warnings = np.ones(len(line), bool), []
    if space is not None and potential is not None:
        e = np.gradient(line, axis=0)
        normals = np.stack([e[:, 1], -e[:, 0]], axis=1) / np.maximum(np.linalg.norm(e, axis=1), 1e-12)[:, None]
        if closed and shoelace(line[:-1]) < 0:
            normals = -normals
        inside = space.inside if space.settings.potential == "map" else np.zeros((0, 0))
        # of so many nodes not every point need be looked at
        each = max(1, int(SPACING * potential.step * len(line) / np.linalg.norm(e, axis=1).sum()))
        found = contour_support(line[::each], normals[::each], potential, inside, space.map.half_width)
        flags = np.repeat(found.supported, each)[: len(line)]
        measures |= support_measures([found])
        if measures["supported_share"] < LEAST_SUPPORT:
            warnings.append(
                f"only {measures['supported_share']:.0%} of the outline lies on edges of the image: check the overlay, draw"
                " the curve nearer to the outline, or mark with not_here or ignore what it must not take"
            )
    if diverged:
        warnings.append("the solver diverged and stopped at its last good state: try a lower solver.step")
    elif not converged:
        warnings.append(f"not at rest after {iterations} iterations: raise solver.iterations")
    h, w = scene.views[0].image.shape[:2]
    if isinstance(o, Snake) and np.mean((line < -0.5).any(axis=1) | (line > [w - 0.5, h - 0.5]).any(axis=1)) > MOST_OUTSIDE:
        warnings.append("the curve has left the image: what lies beyond the border is a guess")
    return LineResult(
        name=o.name,
        kind="snake" if isinstance(o, Snake) else "sheet",
        nodes=nodes[None, :, 0, :2] if isinstance(o, Snake) else nodes[None],
        contour=[line],
        support=[flags],
        measures=measures,
        history=history,
        iterations=iterations,
        converged=converged,
        trusted=not warnings,
        warnings=warnings,
    )


def outline(o: Snake | Sheet, nodes: np.ndarray, camera: Camera) -> np.ndarray:
    """A snake's smooth curve, a sheet's border as the camera sees it, shape (m, 2); closed ones end as they begin."""
    if isinstance(o, Sheet):
        line = camera.project(border(nodes))
    else:
        line = evenly(nodes[:, 0, :2], FINE * o.nodes, o.closed)
        if not o.closed:
            return line
    return np.concatenate([line, line[:1]])


def grid_lines(nodes: np.ndarray) -> list[np.ndarray]:
    """Lines of a sheet's grid (N_x, N_s, 3), polylines of shape (n, 3)."""
    return [*nodes, *nodes.transpose(1, 0, 2)]


def sheet_mesh(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles a cell of a sheet (N_x, N_s, 3): vertices (V, 3), faces (F, 3)."""
    nx, ns, _ = nodes.shape
    i = np.arange(nx * ns).reshape(nx, ns)
    a, b, c, d = i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    return nodes.reshape(-1, 3), faces.reshape(-1, 3)


def sheet_area(nodes: np.ndarray) -> float:
    """Area of a sheet (N_x, N_s, 3) by its triangles."""
    vertices, faces = sheet_mesh(nodes)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
