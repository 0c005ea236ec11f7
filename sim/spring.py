"""Springs and volcanoes of the user (figure 6): when they take hold and let go, where they are tied, and their launches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from ..kernels import spring as kernels
from .camera import Camera
from .initial import lift


@dataclass(frozen=True)
class Spring:
    """A spring from a point of an object to an anchor, or a volcano that pushes the object away from the anchor."""

    anchor: tuple[float, ...]
    """image point (column, row), or world point (x, y, z)."""
    point: tuple[float, ...] | None = None
    """where it is tied, material coordinates in [0, 1]: (s,) along a snake, (x, s) on a tube or sheet."""
    near: tuple[float, ...] | None = None
    """tied to the node nearest to this image or world point at the iteration `start`; for one of point and near."""
    stiffness: float = 1.0
    """force for each unit of displacement; 1 is what the image's force on a whole snake comes to."""
    reach: float | None = None
    """of a volcano [px, or world units with a world point]: nearer than this it is at its strongest; None: a spring."""
    start: int = 0
    """iteration at which it takes hold."""
    stop: int | None = None
    """iteration at which it lets go; None: never."""
    view: int = 0
    """number of the view that its image points are in."""
    frame: int = 0
    """of a moving scene; in one after the first, iterations count from the end of the frame's own."""

    def holds(self, iteration: int) -> bool:
        """Whether it is in force at an iteration."""
        return self.start <= iteration and (self.stop is None or iteration < self.stop)


@dataclass
class Held:
    """An object that springs may hold, as it lies in the flat arrays: (N_s, N_x) nodes from `first` on."""

    springs: list[Spring]
    first: int
    grid: tuple[int, int]
    round: bool
    """x is periodic."""
    spacing: tuple[float, float]
    """hx, hs."""
    unit: float
    """own unit of length [world units]."""
    origin: np.ndarray
    camera: Camera
    """of the first view, takes points in own units."""
    eye: int
    """its number among the model's eyes."""
    others: tuple[Camera, ...] = ()
    """of the other views, the model's eyes after that one."""

    def seen_by(self, view: int) -> Camera:
        """The camera of a view, takes points in own units."""
        return self.others[view - 1] if view else self.camera

    def nodes(self, material: tuple[float, ...]) -> tuple[list[int], list[float]]:
        """Four nodes about a material point and their weights."""
        nx, ns = self.grid
        x, s = material if len(material) == 2 else (material[0], 0.0)
        i, u = divmod(x * nx if self.round else min(x * (nx - 1), nx - 1 - 1e-9), 1.0)
        j, v = divmod(min(s * (ns - 1), max(ns - 1 - 1e-9, 0.0)), 1.0)
        a, b = int(i) % nx, (int(i) + 1) % nx
        low, high = self.first + int(j) * nx, self.first + min(int(j) + 1, ns - 1) * nx
        return [low + a, low + b, high + a, high + b], [(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]

    def nearest(self, place: tuple[float, ...], positions: np.ndarray, view: int = 0) -> tuple[list[int], list[float]]:
        """The node nearest to an image point of a view, of those on the near side, or to a world point."""
        nx, ns = self.grid
        v = positions[self.first : self.first + nx * ns].astype(float)
        if len(place) == 3:
            gap = np.linalg.norm(v - (np.array(place) - self.origin) / self.unit, axis=1)
        else:
            camera = self.seen_by(view)
            gap = np.linalg.norm(camera.project(v) - np.array(place), axis=1)
            far = camera.distance(v).reshape(ns, nx)
            gap[(far > far.mean(axis=1, keepdims=True) + 1e-6).ravel()] += np.ptp(gap) * 0.05
        return [self.first + int(gap.argmin())] * 4, [1.0, 0.0, 0.0, 0.0]


class Springs:
    """All springs of a model; those in force lie in the places of arrays that the captured graph reads.

    What changes with time is written from outside. A graph serves as long as `form` stays.
    """

    def __init__(self, bodies: list[Held], mass: np.ndarray, device: str):
        self.bodies, self.device = bodies, device
        self.owners = [body for body in bodies for _ in body.springs]
        self.list = [spring for body in bodies for spring in body.springs]
        self.tied: list[tuple[list[int], list[float]] | None] = [None] * len(self.list)
        self.way = [0.0] * len(self.list)
        """how far the object was from the anchor when the spring took hold [image px]."""
        self.mass = wp.array(mass.astype(np.float32), dtype=float, device=device)
        self.iteration = -1
        self._make_places(most_at_once(self.list))

    def __len__(self) -> int:
        return len(self.list)

    def _make_places(self, count: int) -> None:
        self.places = count
        self.array = wp.zeros(count, dtype=kernels.Spring, device=self.device)  # pyright: ignore
        self.reply = wp.zeros((count, len(self.mass)), dtype=float, device=self.device)
        self.inverse = wp.zeros((count, count), dtype=float, device=self.device)
        self.back = wp.zeros(count, dtype=wp.vec3, device=self.device)

    @property
    def form(self) -> tuple[int, bool]:
        """What a graph has frozen of the springs: how many at once, and whether any is a volcano."""
        return self.places, any(spring.reach is not None for spring in self.list)

    def add(self, k: int, spring: Spring) -> int:
        """Ties one more to body k while a run goes on, from `spring.start` on, which must be yet to come.

        Returns:
            its number in `list`.

        Raises:
            ValueError: it should have taken hold already.
        """
        if spring.start < self.iteration:
            raise ValueError(f"a spring cannot take hold at iteration {spring.start}, which is over")
        self.list.append(spring)
        self.owners.append(self.bodies[k])
        self.tied.append(None)
        self.way.append(0.0)
        need = most_at_once(self.list)
        if need > self.places:  # some to spare, so that not each one takes a graph of its own
            self._make_places(2 * need)
        return len(self.list) - 1

    def let_go(self, i: int, iteration: int) -> None:
        """Ends spring i at an iteration that is yet to come; one that has not come to pull by then never was."""
        if iteration > self.list[i].start:
            self.list[i] = replace(self.list[i], stop=iteration)
        else:
            self.remove(i)

    def remove(self, i: int) -> None:
        """Takes spring i out of the list; those after it move up."""
        for values in (self.list, self.owners, self.tied, self.way):
            del values[i]

    @property
    def events(self) -> set[int]:
        """Iterations at which any takes hold or lets go."""
        return {at for spring in self.list for at in (spring.start, spring.stop) if at is not None}

    def due(self, iteration: int) -> bool:
        """Whether any takes hold or lets go at this iteration."""
        return iteration in self.events

    def lets_go(self, iteration: int) -> bool:
        """Whether any lets go at this iteration."""
        return any(iteration == spring.stop for spring in self.list)

    def pending(self, iteration: int) -> bool:
        """Whether any has still to take hold or to let go."""
        return any(spring.start >= iteration or (spring.stop or 0) >= iteration for spring in self.list)

    @property
    def _in_force(self) -> list[int]:
        return [i for i, spring in enumerate(self.list) if spring.holds(self.iteration)]

    def set(self, iteration: int, positions: np.ndarray) -> None:
        """Writes what holds at an iteration; those that take hold are tied where the object is now, positions (N, 3)."""
        self.iteration = iteration
        held = self._in_force
        self.tied = [tied if i in held else None for i, tied in enumerate(self.tied)]
        values = [self._value(i, positions) for i in held]
        values += [kernels.Spring() for _ in range(self.places - len(held))]
        if values:
            self.array.assign(wp.array(values, dtype=kernels.Spring, device="cpu").numpy())

    def _value(self, i: int, positions: np.ndarray) -> Any:
        """Spring i as the kernels know it; ties it if it is loose."""
        spring, body = self.list[i], self.owners[i]
        value = kernels.Spring()
        value.stiffness = spring.stiffness
        value.eye = body.eye + spring.view if len(spring.anchor) == 2 else -1
        if len(spring.anchor) == 2:
            value.anchor = wp.vec3(*spring.anchor, 0.0)
        else:
            value.anchor = wp.vec3(*map(float, (np.array(spring.anchor) - body.origin) / body.unit))
        value.first, value.last = body.first, body.first + int(np.prod(body.grid))
        value.density = 1 / float(np.prod(body.spacing))
        if spring.reach is not None:
            value.reach = spring.reach if len(spring.anchor) == 2 else spring.reach / body.unit
            return value
        tied = self.tied[i]
        if tied is None:
            near = spring.near or ()
            tied = body.nodes(spring.point) if spring.point is not None else body.nearest(near, positions, spring.view)
            self.tied[i] = tied
            self.way[i] = float(np.linalg.norm(np.diff(self._segment(i, positions), axis=0)))
        value.n0, value.n1, value.n2, value.n3 = tied[0]
        value.weight = wp.vec4(*tied[1])
        return value

    def segments(self, k: int, positions: np.ndarray) -> list[np.ndarray]:
        """Springs that hold body k, from where they are tied to their anchors, image points (2, 2) each of its own view."""
        return [self._segment(i, positions) for i in self.holding(k)]

    def holding(self, k: int) -> list[int]:
        """Springs that hold body k now, volcanoes left out."""
        return [i for i, tied in enumerate(self.tied) if tied is not None and self.owners[i] is self.bodies[k]]

    def _segment(self, i: int, positions: np.ndarray) -> np.ndarray:
        (nodes, weights), body, anchor = self.tied[i] or ([], []), self.owners[i], np.array(self.list[i].anchor)
        camera = body.seen_by(self.list[i].view)
        if len(anchor) == 3:
            anchor = camera.project((anchor - body.origin) / body.unit)
        return np.stack([camera.project(np.array(weights) @ positions[nodes].astype(float)), anchor])

    def in_space(self, k: int, positions: np.ndarray) -> list[np.ndarray]:
        """Springs that hold body k, world points (2, 3) each; an image point's is as deep as where the spring is tied."""
        body, out = self.bodies[k], []
        for i in self.holding(k):
            (nodes, weights), spring = self.tied[i] or ([], []), self.list[i]
            ends = np.stack([np.array(weights) @ positions[nodes].astype(float)] * 2) * body.unit + body.origin
            if len(spring.anchor) == 3:
                ends[1] = spring.anchor
            else:
                camera = body.seen_by(spring.view).in_units(1 / body.unit, -body.origin / body.unit)
                ends[1] = lift(np.array(spring.anchor)[None], camera, float(camera.depth(ends[0])))[0]
            out.append(ends)
        return out

    def take_implicitly(self, step_under: Callable[[np.ndarray], np.ndarray]) -> None:
        """Makes `give_back` anew; to be called after `set`, and after material or time step changed.

        Args:
            step_under: what a solver's step does to nodes at rest, (N,), under loads per hx hs on them, (N,).
        """
        held = [(place, i) for place, i in enumerate(self._in_force) if self.list[i].reach is None]
        places = [place for place, _ in held]
        reply, inverse = np.zeros(self.reply.shape), np.zeros(self.inverse.shape)
        hangs = np.zeros((len(held), self.reply.shape[1]))
        for row, (place, i) in enumerate(held):
            nodes, weights = self.tied[i] or ([], [])
            np.add.at(hangs[row], nodes, weights)
            reply[place] = step_under(hangs[row] / np.prod(self.owners[i].spacing))
        if held:
            stiffness = np.array([self.list[i].stiffness for _, i in held])
            inverse[np.ix_(places, places)] = np.linalg.inv(np.diag(1 / stiffness) + hangs @ reply[places].T)
        self.reply.assign(reply.astype(np.float32))
        self.inverse.assign(inverse.astype(np.float32))

    def give_back(self, nodes: wp.array, velocity: wp.array) -> None:
        """Makes the step just done, `velocity`, one that has the springs in its matrix: launches only."""
        if not self.places:
            return
        wp.launch(
            kernels.give_way,
            self.places,
            inputs=[self.array, self.inverse, velocity],
            outputs=[self.back],
            device=self.device,
        )
        wp.launch(
            kernels.step_back,
            len(nodes),
            inputs=[self.reply, self.back],
            outputs=[nodes, velocity],
            device=self.device,
        )

    def add_forces(self, eyes: wp.array, nodes: wp.array, force: wp.array) -> None:
        """Adds their forces: launches only, none where there are no springs."""
        if not self.places:
            return
        wp.launch(kernels.spring_force, self.places, inputs=[self.array, eyes, nodes], outputs=[force], device=self.device)
        if self.form[1]:
            wp.launch(
                kernels.volcano_force,
                len(force),
                inputs=[self.array, eyes, self.mass, nodes],
                outputs=[force],
                device=self.device,
            )


def most_at_once(springs: list[Spring]) -> int:
    """How many are in force at the same time, at the most."""
    starts = np.sort([spring.start for spring in springs])
    stops = np.sort([spring.stop for spring in springs if spring.stop is not None])
    held = np.arange(1, len(starts) + 1) - np.searchsorted(stops, starts, side="right")
    return int(held.max(initial=0))
