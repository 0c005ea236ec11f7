"""Still scenes: from rough axes to tubes at rest (sections 4.1 and 5)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import warp as wp

from ..kernels import contour, coupling, elastic, integrate, rim, spring
from .assembly import Assembly
from .fabric import Fabric
from .force import add_forces
from .material import Weight
from .model import State
from .potential import Potential
from .problem import Settings, Tube, View
from .result import ObjectResult, Result, finish
from .solvers import Solver, make_solver

__all__ = ["ObjectResult", "Progress", "Result", "reconstruct"]

CHECK = 10
"""Iterations between two looks at the residual, and at weights that are functions of time."""
COARSE = 3.0
"""How much more residual a coarse scale may keep: the next scale moves the tube further than that anyway."""
REST = 2e-4
"""How far surface and closed ends may still move in `LOOK` iterations at the finest scale; rings within it may slide."""
LOOK = 50
TRAIL = 4
"""Looks from which the limit is extrapolated."""
AHEAD = 2e-4
"""How far the extrapolated limit may still be."""
LEAPS = 3
"""How often a run leaps to the extrapolated limit before it may end."""
LONGEST = 30.0
"""Longest leap, in ways between two looks."""
LOST = 1.0
"""Residual force at which the solver has diverged [initial spine lengths]."""
LEAST_SHARE = 0.01
"""Least share of the rigidities that the finest scale keeps."""
SNAPSHOTS = 90
"""About how many states a run remembers."""


class Progress:
    """Where a run is; handed to the callback each iteration."""

    def __init__(self, scene: Assembly, stages: int):
        self.scene = scene
        self.iteration, self.total = 0, scene.settings.iterations
        self.stage, self.stages, self.sigma, self.residual = 0, stages, 0.0, float("inf")

    @property
    def time(self) -> float:
        """Solver time t: the sum of the time steps dt of all iterations so far, over all stages."""
        return self.scene.time

    def material(self, k: int = 0, **weights: Weight | None) -> None:
        """Changes weights of tube k from the next iteration on: `progress.material(0, w2=1e-5)`.

        Args:
            k: which tube.
            weights: as in a scene file's [object.material], or functions of `time`.

        Raises:
            ValueError: no such weight, or a value that does not fit.
        """
        self.scene.weights.change(k, weights)

    def shape(self, k: int = 0) -> dict[str, np.ndarray]:
        """Natural lengths and curvatures that tube k has now: `material(k01=0.1, **shape())` makes it stay as it is.

        Returns:
            L1 (N_s - 1,), C2 (N_s,), L10, C20, C02 (N_x, N_s), L01, C11 (N_x, N_s - 1), in initial spine lengths.
        """
        return self.scene.shape(k)

    def tube(self, k: int = 0) -> np.ndarray:
        """Nodes of tube k now, shape (N_x, N_s, 3), world units."""
        return self.scene.world(k)[0]

    def spine(self, k: int = 0) -> np.ndarray:
        """Spine of tube k now, shape (N_s, 3), world units."""
        return self.scene.world(k)[1]


class Loop:
    """The iteration, captured as a graph and launched again and again; the step apart where it needs the host.

    Args:
        scene: model, state, weights and settings, their weights written.
        careful: by the plain scheme, without acceleration.
    """

    def __init__(self, scene: Fabric, careful: bool):
        s = scene.settings
        slow, momentum = (1.0, 0.0) if careful else (s.slow, s.momentum)
        self.scene = scene
        self.solver: Solver = make_solver(s.scheme, scene.model, s.step, slow, momentum)
        self._capture()

    def _capture(self) -> None:
        scene, s = self.scene, self.scene.settings
        self.forms = self._forms()
        if scene.model.torn:
            wp.load_module(rim, device=scene.device)
        with wp.ScopedCapture(device=scene.device, force_module_load=False) as capture:
            add_forces(scene.model, scene.state, s.contour, s.force == "paper", s.tau)
            scene.springs.add_forces(scene.model.eyes, scene.state.tube, scene.state.force)
            if self.solver.captured:
                self._step()
        assert capture.graph is not None
        self.graph = capture.graph

    def set_material(self, share: float | None = None) -> None:
        """Writes the weights anew and makes the factors again that depend on what changed; see `Assembly.set_material`."""
        changed, mass = self.scene.set_material(share), self.solver.mass
        if changed:
            self.solver.material_changed(changed)
            self.scene.springs.take_implicitly(self._step_under)
        if self.solver.mass != mass:  # what was repeated of the last step is no velocity
            self.scene.stand_still()
        if self._forms() != self.forms:
            self._capture()

    def _forms(self) -> tuple:
        """What a graph has frozen of model and solver."""
        return self.scene.model.shaped, self.scene.model.torn, *self.solver.form

    def hold_springs(self, iteration: int) -> None:
        """Lets springs take hold and let go, and the scheme take them implicitly."""
        self.scene.springs.set(iteration, self.scene.state.tube.numpy())
        self.scene.springs.take_implicitly(self._step_under)

    def _step_under(self, load: np.ndarray) -> np.ndarray:
        """Step of nodes at rest under a load, both (N,) and in one direction; none with mass, where springs are explicit."""
        if self.solver.mass:
            return np.zeros(len(load))
        trial = State(self.scene.model)
        trial.force.assign((load[:, None] * [1.0, 0.0, 0.0]).astype(np.float32))
        self.solver.step(trial)
        return trial.tube.numpy()[:, 0].astype(float)

    def _step(self) -> None:
        """The scheme's step, with the springs in it."""
        self.solver.step(self.scene.state)
        self.scene.springs.give_back(self.scene.state.tube, self.scene.state.velocity)

    def run(self) -> None:
        """One iteration."""
        wp.capture_launch(self.graph)
        if not self.solver.captured:
            self._step()
        self.scene.time += self.solver.dt

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
    for module in (elastic, coupling, contour, integrate, *[spring] * bool(scene.springs)):
        wp.load_module(module, device=device)
    lists = [space.sigmas for space in scene.spaces]
    stages = max(len(x) for x in lists)
    every = [[x[max(0, len(x) - stages + stage)] for x in lists] for stage in range(stages)]
    ahead = _potentials(scene, every)
    scene.set_material(1.0)
    loop = Loop(scene, careful=False)
    settings = replace(settings, scheme=loop.solver.name)
    lap("kernels")
    progress = Progress(scene, stages)
    history: list[list] = [[] for _ in tubes]
    potentials: list[list[Potential]] = []
    stopped, converged, diverged = False, False, False
    for stage, sigmas in enumerate(every):
        potentials.append([made.result() for made in ahead[stage]])
        scene.set_potentials(potentials[-1])
        lap("potential")
        progress.stage, progress.sigma = stage, sigmas[0]
        if stage > 0:
            scene.deal()
        scene.hold_tangents()
        scene.hold_depth()
        loop.set_material(max(LEAST_SHARE, (sigmas[0] / lists[0][0]) ** 2))
        loop.hold_springs(progress.iteration)
        scene.stand_still()
        start, start_time, begun, again = scene.positions(), scene.time, progress.iteration, False
        tolerance = settings.tolerance * (1.0 if stage == stages - 1 else COARSE)
        # what earlier scales did not use is left to later ones
        end = progress.iteration + (settings.iterations - progress.iteration) // (stages - stage)
        converged, moved, trail, leaps = False, float("inf"), [start], 0
        while progress.iteration < end and not (converged or stopped or diverged):
            if progress.iteration % max(CHECK, settings.iterations // (10 * SNAPSHOTS)) == 0:
                for k in range(len(tubes)):
                    history[k].append((*scene.world(k), sigmas[k], list(scene.weights.cuts[k])))
            if scene.springs.due(progress.iteration):
                loop.hold_springs(progress.iteration)
                # what was under way does not tell of what comes
                begun, moved, trail = progress.iteration, float("inf"), [scene.positions()]
            loop.run()
            progress.iteration += 1
            if stage == stages - 1 and (progress.iteration - begun) % LOOK == 0:
                moved = scene.moved(trail[-1][0])
                trail = [*trail[1 - TRAIL :], scene.positions()]
            if progress.iteration % CHECK == 0 or progress.iteration == end:
                progress.residual = loop.residual()
                at_rest = progress.residual < tolerance and (stage < stages - 1 or moved < REST)
                pending = scene.springs.pending(progress.iteration) or not scene.weights.settled(scene.time)
                converged = at_rest and not (stage == stages - 1 and pending)
                if converged and stage == stages - 1 and leaps < LEAPS and not loop.solver.mass:
                    # what creeps does so for long, by less and less: go where that leads, unless it is here
                    converged = False
                    if len(trail) == TRAIL:
                        tube, spine = limit(trail)
                        converged = scene.moved(tube) < AHEAD
                        if not converged:
                            scene.rewind((tube, spine))
                            leaps, moved, trail = leaps + 1, float("inf"), [scene.positions()]
                if not progress.residual < LOST:
                    scene.rewind(start)
                    scene.time = start_time
                    diverged, again = again, True
                    loop = Loop(scene, careful=True)
                    loop.hold_springs(progress.iteration)
            stopped = bool(callback and callback(progress))
            if scene.weights.stale or (scene.weights.timed and progress.iteration % CHECK == 0):
                loop.set_material()
        lap("solve")
        if stopped or diverged:
            break
    for made in (made for stage in ahead for made in stage):
        made.cancel()  # of scales that were not reached
    objects = []
    for k in range(len(tubes)):
        history[k].append((*scene.world(k), progress.sigma, list(scene.weights.cuts[k])))
        snapshots = _thinned(history[k])
        objects.append(finish(scene, k, potentials[-1][k], snapshots, progress.iteration, converged, diverged))
    lap("measure")
    h, w = views[0].image.shape[:2]
    pictures = [p[0].picture for p in potentials]
    foreground = scene.maps[0].in_image((h, w)) if settings.potential == "map" else None
    return Result(objects, pictures, foreground, seconds, settings)


def _potentials(scene: Assembly, every: list[list[float]]) -> list[list[Future[Potential]]]:
    """For each stage each tube's potential; those of finer scales are made while coarser ones are solved."""
    pool = ThreadPoolExecutor(os.cpu_count())
    ahead = [
        [pool.submit(space.at, sigma, sigmas is every[-1]) for space, sigma in zip(scene.spaces, sigmas, strict=True)]
        for sigmas in every
    ]
    pool.shutdown(wait=False)
    return ahead


def limit(trail: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Where states at equal steps of a linear relaxation lead, by reduced rank extrapolation.

    The mean of the states, weighted so that the ways from one to the next cancel as well as they can; a few modes of
    decay, as many as there are states less two, are met exactly. No further than `LONGEST` of the last ways.

    Args:
        trail: states in turn, three or more, each some arrays of the same shapes.

    Returns:
        arrays of those shapes.
    """
    states = np.array([np.concatenate([np.ravel(a) for a in state]) for state in trail], dtype=float)
    ways = np.diff(states, axis=0)
    gram = ways @ ways.T
    # states rest on float32: what is smaller is no way
    gram += (1e-10 * np.trace(gram) + 1e-30) * np.eye(len(gram))
    weight = np.linalg.solve(gram, np.ones(len(gram)))
    leap = weight / weight.sum() @ states[1:] - states[-1]
    leap *= min(1.0, LONGEST * np.linalg.norm(ways[-1]) / max(np.linalg.norm(leap), 1e-30))
    pieces = np.split(states[-1] + leap, np.cumsum([a.size for a in trail[0]])[:-1])
    return tuple(p.reshape(a.shape).astype(a.dtype) for p, a in zip(pieces, trail[0], strict=True))


def _thinned(history: list) -> list:
    """At most `SNAPSHOTS` states, first and last among them."""
    keep = np.unique(np.linspace(0, len(history) - 1, min(len(history), SNAPSHOTS)).round().astype(int))
    return [history[i] for i in keep]
