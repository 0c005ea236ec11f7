"""One part of a still scene on its way from coarse scale to fine, each to rest (section 5)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace

import numpy as np

from .assembly import Assembly
from .loop import HOST, Loop
from .material import Weight
from .potential import Potential, PotentialPicture
from .problem import Settings
from .spring import Spring

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
HOLD, FIRM = 1e-6, 2e-5
"""Stiffness of the springs that keep nodes where they were dealt, at the finest scale: so little that it does not matter
where they were, until all is all but at rest; then so much that nothing slides along the surface for ever. At once where an
end lies beyond the image, of which nothing else is known."""
SOFT = 600
"""Iterations after which the springs are firm in any case: what is told by little may never come to rest else."""
SETTLING, CREEP = 400, 1e-3
"""Iterations of the finest scale in which what moves is to slow down by half, or it is led on by less momentum: forces of
images have no energy, and what they turn round and round momentum drives on for ever. Below which it creeps [as REST]."""
LOST = 1.0
"""Residual force at which the solver has diverged [initial spine lengths]."""
LEAST_SHARE = 0.01
"""Least share of the rigidities that the finest scale keeps."""
ENOUGH = 12
"""Iterations that a scale needs to be worth it: of fewer in all, the coarsest scales are left out."""
SNAPSHOTS = 90
"""About how many states a run remembers."""


class Relaxation:
    """Tubes of one assembly from coarse to fine scale, together; `advance` takes them on.

    A scale that diverges is done once more from its start by the plain scheme.

    Attributes:
        stage, stages, sigma: the scale in force [px].
        iteration, residual: iterations so far, residual force [initial spine lengths].
        done: nothing is left to do; then `converged` (at rest at the finest scale) or `diverged` may hold.
        history: snapshots of each tube, see `ObjectResult`.
        pictures: of the first tube's potential at each scale.
        potentials: in force, one for each tube and view.
        waited: seconds in which it could not go on for want of a potential.

    Args:
        scene: the assembly, at its start.
        pool: makes potentials while others are solved.
        ahead: of how many scales; each takes memory.
        drawn: keep the pictures.

    Raises:
        ValueError: the scheme cannot bear the step, mass, or the material.
    """

    def __init__(self, scene: Assembly, pool: Executor, ahead: int = 1, drawn: bool = True):
        self.scene, self._pool = scene, pool
        lists = [[space.sigmas for space in row] for row in scene.spaces]
        self.stages = max(len(x) for row in lists for x in row)
        self._sigmas = [
            [[x[max(0, len(x) - self.stages + stage)] for x in row] for row in lists] for stage in range(self.stages)
        ]
        first = max(0, self.stages - max(1, scene.settings.iterations // ENOUGH))
        self.stage, self.sigma, self.iteration, self.residual = first, self._sigmas[first][0][0], 0, float("inf")
        self.done, self.converged, self.diverged = False, False, False
        self.history: list[list] = [[] for _ in scene.tubes]
        self._snapshot_every = CHECK * max(1, scene.settings.iterations // (10 * SNAPSHOTS * CHECK))
        self.pictures: list[PotentialPicture] = []
        self._drawn = drawn
        self.potentials: list[list[Potential]] = []
        self.waited = 0.0
        self._ahead = [self._made(stage) for stage in range(first, min(first + ahead, self.stages))]
        with HOST:
            scene.set_material(1.0)
            self.loop = Loop(scene, careful=False)
        self._again, self._under_way, self._firm, self._held = False, False, False, 0

    @property
    def last(self) -> bool:
        """Whether the finest scale is in force."""
        return self.stage == self.stages - 1

    def advance(self, count: int) -> None:
        """Goes on by `count` iterations, or fewer to its end."""
        until = self.iteration + count
        while self.iteration < until and not self.done:
            if not self._under_way:
                self._begin()
            with HOST:
                self._before()
            steps = min(until, self._next_event()) - self.iteration
            self.loop.run(steps)
            self.iteration += steps
            with HOST:
                self._after()

    def see_again(self, changed: bool) -> None:
        """Takes in what hides the tubes; at rest, they go on at the finest scale if that has `changed` much."""
        if not self._under_way and not self.done:
            return  # the next scale will
        with HOST:
            self.scene.set_potentials(self.potentials)
        if not changed:
            return
        if self.done and not self.diverged and self.iteration < self._end:
            self.done, self.converged, self._under_way = False, False, True
        self._watch()

    def stop(self) -> None:
        """Ends the run where it is."""
        self.done = True
        for one in (one for stage in self._ahead for made in stage for one in made):
            one.cancel()

    def pull(self, k: int, spring: Spring) -> int:
        """Ties a spring to tube k or sets a volcano, from this iteration on, or from `spring.start`; a run at rest goes on.

        Returns:
            its number, for `let_go`.

        Raises:
            ValueError: it should have taken hold already.
        """
        i = self.scene.springs.add(k, replace(spring, start=max(spring.start, self.iteration)))
        self._go_on()
        return i

    def let_go(self, i: int) -> None:
        """Ends spring i at this iteration."""
        self.scene.springs.let_go(i, self.iteration)
        self._go_on()

    def change(self, k: int, weights: Mapping[str, Weight | None]) -> None:
        """Changes weights of tube k from this iteration on, see `Progress.material`; a run at rest goes on."""
        self.scene.weights.change(k, weights)
        self._go_on()
        if self._under_way:
            self._hold_softly()
            self._look_anew()

    def _go_on(self) -> None:
        """After an event that somebody made: at the finest scale there is as long a way to go as from the start."""
        scene, most = self.scene, self.iteration + Settings.iterations
        if most > scene.settings.iterations:
            scene.settings = replace(scene.settings, iterations=most)
        if self.last and (self._under_way or self.done) and not self.diverged:
            self._end, self._under_way, self.done, self.converged = scene.settings.iterations, True, False, False

    def snapshot(self) -> None:
        """Remembers where every tube is."""
        for k, states in enumerate(self.history):
            tube, spine = (nodes.astype(np.float32) for nodes in self.scene.world(k))
            states.append((tube, spine, self._sigmas[self.stage][k][0], list(self.scene.weights.cuts[k])))

    def _made(self, stage: int) -> list[list[Future[Potential]]]:
        """Potentials of a scale, under way."""
        return [
            [self._pool.submit(space.at, s, stage == self.stages - 1) for space, s in zip(*pair, strict=True)]
            for pair in zip(self.scene.spaces, self._sigmas[stage], strict=True)
        ]

    def _begin(self) -> None:
        """Sets the scale in force."""
        scene, s = self.scene, self.scene.settings
        clock = time.perf_counter()
        self.potentials = [[one.result() for one in made] for made in self._ahead.pop(0)]
        self.waited += time.perf_counter() - clock
        beyond = self.stage + 1 + len(self._ahead)
        if beyond < self.stages:
            self._ahead.append(self._made(beyond))
        if self.last:
            for space in (space for row in scene.spaces for space in row):
                space.forget()
        if self._drawn:
            self.pictures.append(self.potentials[0][0].picture)
        self.sigma = self._sigmas[self.stage][0][0]
        with HOST:
            # what is few pixels wide has few scales: at the last it bends as freely as what is large
            share = 0.0 if self.last else (self.sigma / self._sigmas[0][0][0]) ** 2
            scene.weights.share = max(LEAST_SHARE, share)
            scene.set_potentials(self.potentials)
            if self.stage > 0:
                scene.deal()
            scene.hold_tangents()
            self._hold_softly()
            scene.hold_depth()
            self.loop.set_material()
            self.loop.hold_springs(self.iteration)
            scene.stand_still()
            self._start = scene.positions(), scene.time
        self._begun, self._again, self._under_way = self.iteration, False, True
        # what earlier scales did not use is left to later ones
        most = s.iterations if self.last else min(s.iterations, Settings.iterations)
        self._end = self.iteration + max(0, most - self.iteration) // (self.stages - self.stage)
        self._leaps, self._moved, self._earlier = 0, float("inf"), float("inf")
        self._trail: list[tuple[np.ndarray, np.ndarray]] = [self._start[0]]
        if self._end == self.iteration:
            self._finish_stage()

    def _before(self) -> None:
        """What is to be done at this iteration before it: weights, snapshots, springs."""
        scene, weights = self.scene, self.scene.weights
        if weights.stale or (weights.timed and self.iteration % CHECK == 0):
            self.loop.set_material()
        if self.iteration % self._snapshot_every == 0:
            if len(self.history[0]) == 2 * SNAPSHOTS:
                for states in self.history:
                    del states[1::2]
                self._snapshot_every *= 2
            self.snapshot()
        if scene.springs.due(self.iteration):
            self.loop.hold_springs(self.iteration)
            self._look_anew()

    def _look_anew(self) -> None:
        """What was under way does not tell of what comes."""
        self.loop.rouse()
        self._leaps = 0
        self._watch()

    def _watch(self) -> None:
        """From here on, whether it moves."""
        self._begun, self._trail = self.iteration, [self.scene.positions()]
        self._moved = self._earlier = float("inf")

    def _next_event(self) -> int:
        """The next iteration before or after which there is something to do."""
        i = self.iteration
        events = [self._end, i + CHECK - i % CHECK, i + LOOK - (i - self._begun) % LOOK]
        return min(events + [e for e in self.scene.springs.events if e > i])

    def _after(self) -> None:
        """Looks whether the scale is at rest, or lost."""
        scene, last = self.scene, self.last
        if last and (self.iteration - self._begun) % LOOK == 0:
            self._moved = scene.moved(self._trail[-1][0])
            self._trail = [*self._trail[1 - TRAIL :], scene.positions()]
            if (self.iteration - self._begun) % SETTLING == 0 and not self.loop.solver.mass:
                self._settle()
        if self.iteration % CHECK and self.iteration != self._end:
            return
        self.residual = self.loop.residual()
        tolerance = scene.settings.tolerance * (1.0 if last else COARSE)
        at_rest = self.residual < tolerance and (not last or self._moved < REST)
        self.converged = at_rest
        if self.converged and last and self._leaps < LEAPS and not self.loop.solver.mass:
            self._leap()
        if last and not self._firm and (self.converged or self.iteration - self._held >= SOFT):
            self._hold(FIRM)
            self.converged, self._moved = False, float("inf")
        if not self.residual < LOST:
            self._go_back()
        # what is done until an event does not depend on it: a spring that is added later leads to the same bits
        pending = (
            last and self.converged and (scene.springs.pending(self.iteration) or not scene.weights.settled(scene.time))
        )
        finished = self.converged and not pending
        if finished or self.diverged or self.iteration >= self._end:
            self._finish_stage()

    def _hold_softly(self) -> None:
        """Before nodes are to move, at the finest scale."""
        if self.last:
            self._hold(FIRM if self.scene.leaves else HOLD)

    def _hold(self, stiffness: float) -> None:
        self.scene.hold_shares(stiffness)
        self._firm, self._held = stiffness == FIRM, self.iteration

    def _leap(self) -> None:
        """What creeps does so for long, by less and less: goes where that leads, unless it is here."""
        self.converged = False
        if len(self._trail) < TRAIL:
            return
        self.converged = self.scene.moved(limit(self._trail)[0]) < AHEAD
        if not self.converged:
            self._jump()
            self._leaps += 1

    def _settle(self) -> None:
        """Leads on with less momentum what has not slowed down by half since this was asked last, and to where it creeps."""
        slower, self._earlier = self._moved <= self._earlier / 2, self._moved
        if slower:
            return
        self.loop.calm()
        if self._firm and self._moved < CREEP and len(self._trail) == TRAIL:
            self._jump()

    def _jump(self) -> None:
        """To where the last looks lead."""
        tube, spine = limit(self._trail)
        self.scene.rewind((tube, spine))
        self._moved, self._trail = float("inf"), [self.scene.positions()]

    def _go_back(self) -> None:
        """To where the scale started, to do it again by the plain scheme; once."""
        positions, self.scene.time = self._start
        self.scene.rewind(positions)
        self._hold_softly()
        self.diverged, self._again = self._again, True
        self.loop = Loop(self.scene, careful=True)
        self.loop.hold_springs(self.iteration)

    def _finish_stage(self) -> None:
        self._under_way = False
        if self.diverged or self.last:
            self.stop()
        else:
            self.stage += 1


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


def thinned(history: list) -> list:
    """At most `SNAPSHOTS` states, first and last among them."""
    keep = np.unique(np.linspace(0, len(history) - 1, min(len(history), SNAPSHOTS)).round().astype(int))
    return [history[i] for i in keep]
