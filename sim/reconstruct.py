"""Still scenes: from rough axes to tubes at rest (sections 4.1 and 5)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp

from ..kernels import contour, coupling, elastic, integrate
from .assembly import Assembly
from .force import add_forces
from .potential import Potential
from .problem import Settings, Tube, View
from .result import ObjectResult, Result, finish
from .solvers import Solver, make_solver

__all__ = ["ObjectResult", "Progress", "Result", "reconstruct"]

CHECK = 10
"""Iterations between two looks at the residual."""
COARSE = 3.0
"""How much more residual a coarse scale may keep: the next scale moves the tube further than that anyway."""
REST = 4e-4
"""How far surface and closed ends may still move in `LOOK` iterations at the finest scale; rings within it may slide."""
LOOK = 50
LOST = 1.0
"""Residual force at which the solver has diverged [initial spine lengths]."""
LEAST_SHARE = 0.01
"""Least share of the rigidities that the finest scale keeps."""
SNAPSHOTS = 90
"""About how many states a run remembers."""


class Progress:
    """Where a run is; handed to the callback each iteration."""

    def __init__(self, scene: Assembly, stages: int):
        self._scene = scene
        self.iteration, self.total = 0, scene.settings.iterations
        self.stage, self.stages, self.sigma, self.residual = 0, stages, 0.0, float("inf")

    def tube(self, k: int = 0) -> np.ndarray:
        """Nodes of tube k now, shape (N_x, N_s, 3), world units."""
        return self._scene.world(k)[0]

    def spine(self, k: int = 0) -> np.ndarray:
        """Spine of tube k now, shape (N_s, 3), world units."""
        return self._scene.world(k)[1]


class _Loop:
    """The iteration, captured as a graph and launched again and again; the step apart where it needs the host."""

    def __init__(self, scene: Assembly, careful: bool):
        s = scene.settings
        slow, momentum = (1.0, 0.0) if careful else (s.slow, s.momentum)
        self.scene = scene
        self.solver: Solver = make_solver(s.scheme, scene.model, s.step, slow, momentum)
        with wp.ScopedCapture(device=scene.device, force_module_load=False) as capture:
            add_forces(scene.model, scene.state, s.contour, s.force == "paper", s.tau)
            if self.solver.captured:
                self.solver.step(scene.state)
        assert capture.graph is not None
        self.graph = capture.graph

    def run(self) -> None:
        """One iteration."""
        wp.capture_launch(self.graph)
        if not self.solver.captured:
            self.solver.step(self.scene.state)

    def residual(self) -> float:
        """Residual force of place and radius, root mean square over all rings [initial spine lengths]."""
        return float(np.sqrt(self.scene.state.residual.numpy().mean()))


def reconstruct(
    views: list[View],
    tubes: list[Tube],
    settings: Settings | None = None,
    device: str = "cpu",
    callback: Callable[[Progress], bool | None] | None = None,
) -> Result:
    """Reconstructs the tubes of a still scene.

    From coarse to fine scale, each to rest. A scale that diverges is done once more from its start by the plain scheme.

    Args:
        views: the images; one for now.
        tubes: rough axes and materials.
        settings: of the solver; the result holds them with the scheme that "auto" chose.
        device: Warp device.
        callback: called each iteration; returning True stops the run.

    Returns:
        The objects with their measures, the potentials, seconds by phase.

    Raises:
        ValueError: the scheme cannot bear the step, mass, or the material.
    """
    settings = settings or Settings()
    clock, seconds = time.perf_counter(), {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[name] = seconds.get(name, 0.0) + now - clock
        clock = now

    scene = Assembly(views, tubes, settings, device)
    lap("map")
    for module in (elastic, coupling, contour, integrate):
        wp.load_module(module, device=device)
    lists = [space.sigmas for space in scene.spaces]
    stages = max(len(x) for x in lists)
    scene.set_material(1.0)
    loop = _Loop(scene, careful=False)
    settings = replace(settings, scheme=loop.solver.name)
    lap("kernels")
    progress = Progress(scene, stages)
    history: list[list] = [[] for _ in tubes]
    potentials: list[list[Potential]] = []
    stopped, converged, diverged = False, False, False
    for stage in range(stages):
        sigmas = [x[max(0, len(x) - stages + stage)] for x in lists]
        finest = stage == stages - 1
        potentials.append([space.at(sigma, finest) for space, sigma in zip(scene.spaces, sigmas, strict=True)])
        scene.set_potentials(potentials[-1])
        lap("potential")
        progress.stage, progress.sigma = stage, sigmas[0]
        if stage > 0:
            scene.deal()
        scene.hold_tangents()
        scene.hold_depth()
        scene.set_material(max(LEAST_SHARE, (sigmas[0] / lists[0][0]) ** 2))
        loop.solver.material_changed()
        scene.stand_still()
        start, begun, again = scene.positions(), progress.iteration, False
        tolerance = settings.tolerance * (1.0 if stage == stages - 1 else COARSE)
        # what earlier scales did not use is left to later ones
        end = progress.iteration + (settings.iterations - progress.iteration) // (stages - stage)
        converged, moved, before = False, float("inf"), start[0]
        while progress.iteration < end and not (converged or stopped or diverged):
            if progress.iteration % max(CHECK, settings.iterations // (10 * SNAPSHOTS)) == 0:
                for k in range(len(tubes)):
                    history[k].append((*scene.world(k), sigmas[k]))
            loop.run()
            progress.iteration += 1
            if stage == stages - 1 and (progress.iteration - begun) % LOOK == 0:
                moved, before = scene.moved(before), scene.positions()[0]
            if progress.iteration % CHECK == 0 or progress.iteration == end:
                progress.residual = loop.residual()
                converged = progress.residual < tolerance and (stage < stages - 1 or moved < REST)
                if not progress.residual < LOST:
                    scene.rewind(start)
                    diverged, again = again, True
                    loop = _Loop(scene, careful=True)
            stopped = bool(callback and callback(progress))
        lap("solve")
        if stopped or diverged:
            break
    objects = []
    for k in range(len(tubes)):
        history[k].append((*scene.world(k), progress.sigma))
        snapshots = _thinned(history[k])
        objects.append(finish(scene, k, potentials[-1][k], snapshots, progress.iteration, converged, diverged))
    lap("measure")
    h, w = views[0].image.shape[:2]
    pictures = [p[0].picture for p in potentials]
    foreground = scene.maps[0].in_image((h, w)) if settings.potential == "map" else None
    return Result(objects, pictures, foreground, seconds, settings)


def _thinned(history: list) -> list:
    """At most `SNAPSHOTS` states, first and last among them."""
    keep = np.unique(np.linspace(0, len(history) - 1, min(len(history), SNAPSHOTS)).round().astype(int))
    return [history[i] for i in keep]
