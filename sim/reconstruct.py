"""Still scenes: from rough axes to tubes at rest (sections 4.1 and 5)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import repeat

import numpy as np
import warp as wp

from ..kernels import contour, coupling, depth, elastic, integrate, pole, spring
from .assembly import Assembly, maps_of
from .material import Weight
from .order import in_order, tell
from .problem import Settings, Tube, View
from .relax import Relaxation, thinned
from .result import ObjectResult, Result, finish
from .visibility import Pass, Visibility, note_others

__all__ = ["ObjectResult", "Progress", "Result", "reconstruct"]

SCALES = 8
"""Of so many scales the potentials of a single tube are made ahead; of many tubes memory bears one."""
REFRESH, ALONE = 20, 100
"""Iterations between two looks at what hides the tubes; and whether a lone one lies before itself."""
WAKES = 5
"""How often tubes at rest may start again because what hides them has changed."""


class Progress:
    """Where a run is; handed to the callback each iteration."""

    def __init__(self, parts: Sequence[Relaxation]):
        self.parts = list(parts)
        self.iteration, self.total = 0, parts[0].scene.settings.iterations
        self._where = [(part, k) for part in parts for k in range(len(part.scene.tubes))]

    @property
    def _last(self) -> Relaxation:
        """The part that is furthest from its end."""
        return min(self.parts, key=lambda part: (part.done, part.stage - part.stages, -part.residual))

    @property
    def stage(self) -> int:
        """Scale at which the last of the tubes is, from 0."""
        return self._last.stage

    @property
    def stages(self) -> int:
        """How many scales that tube goes through."""
        return self._last.stages

    @property
    def sigma(self) -> float:
        """That scale [px]."""
        return self._last.sigma

    @property
    def residual(self) -> float:
        """That tube's residual force [initial spine lengths]."""
        return self._last.residual

    @property
    def time(self) -> float:
        """Solver time t of the last tube: the sum of the time steps dt of its iterations so far, over all stages."""
        return self._last.scene.time

    def material(self, k: int = 0, **weights: Weight | None) -> None:
        """Changes weights of tube k from the next iteration on: `progress.material(0, w2=1e-5)`.

        Args:
            k: which tube.
            weights: as in a scene file's [object.material], or functions of `time`.

        Raises:
            ValueError: no such weight, or a value that does not fit.
        """
        part, own = self._where[k]
        part.scene.weights.change(own, weights)

    def shape(self, k: int = 0) -> dict[str, np.ndarray]:
        """Natural lengths and curvatures that tube k has now: `material(k01=0.1, **shape())` makes it stay as it is.

        Returns:
            L1 (N_s - 1,), C2 (N_s,), L10, C20, C02 (N_x, N_s), L01, C11 (N_x, N_s - 1), in initial spine lengths.
        """
        part, own = self._where[k]
        return part.scene.shape(own)

    def tube(self, k: int = 0) -> np.ndarray:
        """Nodes of tube k now, shape (N_x, N_s, 3), world units."""
        part, own = self._where[k]
        return part.scene.world(own)[0]

    def spine(self, k: int = 0) -> np.ndarray:
        """Spine of tube k now, shape (N_s, 3), world units."""
        part, own = self._where[k]
        return part.scene.world(own)[1]


def reconstruct(
    views: list[View],
    tubes: list[Tube],
    settings: Settings | None = None,
    device: str = "cpu",
    callback: Callable[[Progress], bool | None] | None = None,
    every: int = 1,
    threads: int | None = None,
    depth_pass: Pass | None = None,
) -> Result:
    """Reconstructs the tubes of a still scene.

    Each goes from coarse to fine scale and stops by itself; on a CPU each has arrays and a graph of its own, so that
    they fit the caches and threads share them out. The bits do not depend on how many threads there are.

    Args:
        views: the images, taken at one time by cameras in one world.
        tubes: rough axes and materials.
        settings: of the solver; the result holds them with the scheme that "auto" chose.
        device: Warp device.
        callback: called with where the run is; returning True stops it.
        every: iterations between two calls.
        threads: that share the tubes; None: one a core.
        depth_pass: how to find what hides the tubes, with `settings.visibility` "depth"; None: by rays.

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

    tubes, found = in_order(views[0], tubes)
    maps = maps_of(views, tubes)
    lap("map")
    several, held = [depth] * (len(views) > 1), [spring] * any(tube.springs for tube in tubes)
    for module in (elastic, coupling, contour, pole, integrate, *several, *held):
        wp.load_module(module, device=device)
    shares = [[k] for k in range(len(tubes))] if device == "cpu" else [list(range(len(tubes)))]
    threads = min(threads or os.cpu_count() or 1, len(shares))
    with ThreadPoolExecutor(os.cpu_count()) as ahead, ThreadPoolExecutor(threads) as pool:
        scales = SCALES if len(shares) == 1 else 1
        parts = [
            Relaxation(
                Assembly(views, [tubes[k] for k in share], settings, device, [maps[k] for k in share]),
                ahead,
                scales,
                0 in share,
            )
            for share in shares
        ]
        lap("kernels")
        look = Look(parts, settings, depth_pass)
        _run(parts, pool, look, callback, every)
        waited = sum(part.waited for part in parts) / threads
        lap("solve")
        seconds["potential"], seconds["solve"] = waited, seconds["solve"] - waited
        if len(tubes) > 1:
            note_others([part.scene for part in parts])
        settings, pictures = replace(settings, scheme=parts[0].loop.solver.name), parts[0].pictures
        waiting = [pool.submit(_finished, part) for part in parts]
        parts.clear()  # each is let go when it is finished: memory need not hold all of them beside all results
        objects = [o for finished in waiting for o in finished.result()]
    for o, order in zip(objects, found, strict=True):
        tell(o, order)
    lap("measure")
    foreground = maps[0][0].in_image(views[0].image.shape[:2]) if settings.potential == "map" else None
    return Result(objects, pictures, foreground, seconds, settings)


class Look:
    """Looks every `REFRESH` iterations, or `ALONE` of a single tube, what hides the tubes."""

    def __init__(self, parts: list[Relaxation], settings: Settings, depth_pass: Pass | None):
        self.every = REFRESH if len(parts) > 1 else ALONE
        self.parts, self.wakes, self.last = parts, 0, -self.every
        self.visibility = Visibility(depth_pass if settings.visibility == "depth" else None)
        self.off = settings.visibility == "off"

    def again(self, iteration: int) -> None:
        """To be called between iterations; at the end of all parts it looks once more and may wake some."""
        done = all(part.done for part in self.parts)
        if (iteration - self.last < self.every and not done) or (done and self.wakes == WAKES):
            return
        self.last = iteration
        if self.off:
            return
        self.wakes += done
        for part, changed in zip(self.parts, self.visibility.refresh([p.scene for p in self.parts]), strict=True):
            if changed is not None and not part.diverged:
                part.see_again(changed)


def _run(
    parts: list[Relaxation],
    pool: ThreadPoolExecutor,
    look: Look,
    callback: Callable[[Progress], bool | None] | None,
    every: int,
) -> None:
    """Takes all parts to their ends; looks do not depend on whether somebody watches, every so many iterations."""
    progress, passed = Progress(parts), 0
    look.again(0)
    while going := [part for part in parts if not part.done]:
        count = look.last + look.every - passed
        if callback:
            count = min(count, every - passed % every)
        passed += count
        if len(going) == 1:
            going[0].advance(count)
        else:
            list(pool.map(Relaxation.advance, going, repeat(count)))
        progress.iteration = max(part.iteration for part in parts)
        done = all(part.done for part in parts)
        if callback and (passed % every == 0 or done) and callback(progress):
            for part in going:
                part.stop()
            return
        look.again(passed)


def _finished(part: Relaxation) -> list[ObjectResult]:
    part.snapshot()
    return [
        finish(part.scene, k, potentials, thinned(part.history[k]), part.iteration, part.converged, part.diverged)
        for k, potentials in enumerate(part.potentials)
    ]
