"""One object's run in the studio: where it is, and what the mouse does to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from symseek.sim.assembly import Assembly
from symseek.sim.fields import PLACES, Cut
from symseek.sim.foreground import Foreground
from symseek.sim.measure import contour_support, support_measures
from symseek.sim.problem import Settings, Tube, View
from symseek.sim.relax import Relaxation
from symseek.sim.spring import Spring
from symseek.sim.surface import occluding_contour

STRENGTH = 4.0
"""Stiffness of the mouse's spring."""
PUSH = 0.3
"""Stiffness of its volcano: enough to take the contour some way off its edge, not so much that it cannot return."""
GRIP = 0.08
"""How far to both sides along an object the mouse takes hold of it, less and less [its length]: a ring alone would be drawn
out to a disc."""
REACH = 0.03
"""Reach of the mouse's volcano [the object's length]: from further off it would slide nodes along the surface alone."""


@dataclass(frozen=True)
class Wish:
    """An object as it should be."""

    structure: str
    """see `Item.structure`."""
    tube: Tube


@dataclass(frozen=True)
class Snapshot:
    """Where an object's run is, in world units."""

    tube: np.ndarray
    """shape (N_x, N_s, 3)."""
    spine: np.ndarray
    """shape (N_s, 3)."""
    cuts: list[Cut]
    iteration: int
    stage: int
    stages: int
    sigma: float
    residual: float
    done: bool
    converged: bool
    diverged: bool
    pulls: list[np.ndarray]
    """springs that hold, from the object to the anchor, shape (2, 3) each."""
    support: tuple[float, float] | None = None
    """mean distance of the contour from its edge [px] and supported share, over all views, when last measured."""
    frame: int = 0
    """of a moving scene; what follows is of those after the first."""
    note: str = ""
    """why it is not to be trusted, or nothing."""
    off: float = 0.0
    """mean way of the contour to its edges [px]."""


@dataclass
class Grip:
    """What the mouse holds."""

    springs: list[int]
    """their numbers; the last ones of the run."""
    places: np.ndarray
    """where what they hold was when it was taken hold of, the middle first, shape (n, 2) image points or (n, 3)."""
    shares: np.ndarray
    """of the mouse's way that each one's anchor goes, shape (n,)."""

    def anchors(self, mouse: Sequence[float]) -> list[tuple[float, ...]]:
        """Of each spring; the middle of what is held goes where the mouse is."""
        way = np.asarray(mouse, float) - self.places[0]
        return [tuple(map(float, at)) for at in self.places + self.shares[:, None] * way]

    def move(
        self, mouse: Sequence[float], listed: list[Spring], now: int,
        pull: Callable[[int, Spring], int], let_go: Callable[[int], None],
    ) -> None:  # fmt: skip
        """The mouse goes elsewhere: other springs take the place of those that have pulled."""
        held, anchors = [listed[i] for i in self.springs], self.anchors(mouse)
        if anchors == [s.anchor for s in held]:
            return
        if held[0].start == now:  # they have not pulled yet
            for i, anchor in zip(self.springs, anchors, strict=True):
                listed[i] = replace(listed[i], anchor=anchor)
            return
        for i in self.springs:
            let_go(i)
        self.springs = [pull(0, replace(s, anchor=a, start=now)) for s, a in zip(held, anchors, strict=True)]


def gripped(
    tube: np.ndarray, views: Sequence[View], point: tuple[float, float], mouse: tuple[float, ...], push: bool, view: int
) -> tuple[Grip, list[Spring]]:
    """What the mouse takes hold of on a tube, and the springs that do; see `Engine.grab`."""
    if push:
        axis = views[view].camera.project(tube.mean(axis=0))
        reach = REACH * float(np.linalg.norm(np.diff(axis, axis=0), axis=1).sum())
        return Grip([], np.array([mouse]), np.ones(1)), [Spring(mouse, reach=reach, stiffness=PUSH, view=view)]
    nx, ns, _ = tube.shape
    i, j, far = round(point[0] * nx) % nx, round(point[1] * (ns - 1)), max(1, round(GRIP * (ns - 1)))
    rings = np.arange(max(j - far, 0), min(j + far, ns - 1) + 1)
    rings = rings[np.argsort(np.abs(rings - j), kind="stable")]
    places = tube[i, rings] if len(mouse) == 3 else views[view].camera.project(tube[i, rings])
    grip = Grip([], places, np.exp(-0.5 * ((rings - j) / (0.5 * far)) ** 2))
    tied = [(i / nx, float(ring / (ns - 1))) for ring in rings]
    return grip, [
        Spring(anchor, at, stiffness=STRENGTH, view=view) for at, anchor in zip(tied, grip.anchors(mouse), strict=True)
    ]


class Part:
    """One object's run, and what the mouse does to it; called by the engine's thread alone.

    Args:
        wish: the object.
        views: images and cameras.
        maps: its foreground map in each view.
        settings: of the solver.
        device: Warp device.
        ahead: makes potentials beside the run.
        scales: of how many at once, while a person looks at what was drawn: a run need not wait then. They take memory.
    """

    def __init__(
        self, wish: Wish, views: list[View], maps: list[Foreground], settings: Settings, device: str, ahead: Executor,
        scales: int = 1,
    ):  # fmt: skip
        self.wish, self.views, self.map = wish, views, maps
        self.run = Relaxation(Assembly(views, [wish.tube], settings, device, [maps]), ahead, scales)
        self.go = False
        """it goes on, unless it is done."""
        self.path = True
        """it went as `symseek run` would go; not so after a change of its material on the way."""
        self.held: Grip | None = None
        self.measured: tuple[float, float] | None = None

    @property
    def active(self) -> bool:
        """Whether there is something to do."""
        return self.go and not self.run.done

    def hold(self, point: tuple[float, float], mouse: tuple[float, ...], push: bool, view: int = 0) -> None:
        """See `Engine.grab`."""
        self.let_go(False)
        self.held, springs = gripped(self.run.scene.world(0)[0], self.views, point, mouse, push, view)
        self.held.springs = [self.run.pull(0, spring) for spring in springs]

    def drag(self, mouse: tuple[float, ...]) -> None:
        """See `Engine.drag`."""
        if self.held is not None:
            self.held.move(mouse, self.run.scene.springs.list, self.run.iteration, self.run.pull, self.run.let_go)

    def let_go(self, pin: bool) -> list[Spring]:
        """See `Engine.let_go`."""
        if self.held is None:
            return []
        if not pin:
            for i in reversed(self.held.springs):
                self.run.let_go(i)
        self.held, before = None, self.wish.tube
        listed = tuple(self.run.scene.springs.list)
        self.wish = replace(self.wish, tube=replace(before, springs=listed))
        made = list(listed[len(before.springs) :])
        self.path &= bool(made)  # it went on from its rest all the same
        return made

    @property
    def hides(self) -> bool:
        """Whether anything hides a part of it."""
        return any(hidden is not None for hidden in self.run.scene.hidden[0])

    def change(self, wish: Wish) -> None:
        """Goes on with another material."""
        pairs = {n: (getattr(self.wish.tube.material, n), getattr(wish.tube.material, n)) for n in PLACES}
        changed = {name: b for name, (a, b) in pairs.items() if a != b}
        self.wish = wish
        if changed:
            self.run.change(0, changed)
            self.path = False

    def measure(self) -> None:
        """Mean distance of the contour from its edges [px], and the share that has some."""
        if not self.run.potentials:
            return
        scene, found = self.run.scene, []
        tube, cuts = scene.world(0)[0], scene.weights.cuts[0]
        for view, space, potential, m in zip(self.views, scene.spaces[0], self.run.potentials[0], self.map, strict=True):
            inside = space.inside if scene.settings.potential == "map" else np.zeros((0, 0))
            for points, normals in occluding_contour(tube, view.camera, cuts):
                found.append(contour_support(points, normals, potential, inside, m.half_width))
        measures = support_measures(found)
        self.measured = measures["contour_residual_px"]["mean"], measures["supported_share"]

    def snapshot(self) -> Snapshot:
        """Where it is."""
        run = self.run
        tube, spine = run.scene.world(0)
        pulls = run.scene.springs.in_space(0, run.scene.state.tube.numpy())
        return Snapshot(
            tube, spine, list(run.scene.weights.cuts[0]), run.iteration, run.stage, run.stages, run.sigma, run.residual,
            run.done, run.converged, run.diverged, pulls, self.measured,
        )  # fmt: skip


def fixed(wish: Wish) -> tuple:
    """What makes another first frame of a moving scene if it changes."""
    return wish.structure, wish.tube.springs, wish.tube.material


def same_maps(a: Sequence[Foreground], b: Sequence[Foreground]) -> bool:
    """Whether an object's maps, one for each view, are the same."""
    return all(m is n or (m.origin == n.origin and np.array_equal(m.inside, n.inside)) for m, n in zip(a, b, strict=True))


def first_difference(new: Sequence[Spring], old: Sequence[Spring]) -> int:
    """Iteration up to which two runs with these springs are the same."""
    differ = [s.start for s in {*new} ^ {*old}]
    return min(differ, default=0)
