"""Springs and volcanoes of the user (figure 6): when they take hold and let go, where they are tied, and their launches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import spring as kernels
from .camera import Camera


@dataclass(frozen=True)
class Spring:
    """A spring from a point of an object to an anchor, or a volcano that pushes the object away from the anchor."""

    anchor: tuple[float, ...]
    """image point (column, row) of the first view, or world point (x, y, z)."""
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

    def nodes(self, material: tuple[float, ...]) -> tuple[list[int], list[float]]:
        """Four nodes about a material point and their weights."""
        nx, ns = self.grid
        x, s = material if len(material) == 2 else (material[0], 0.0)
        i, u = divmod(x * nx if self.round else min(x * (nx - 1), nx - 1 - 1e-9), 1.0)
        j, v = divmod(min(s * (ns - 1), max(ns - 1 - 1e-9, 0.0)), 1.0)
        a, b = int(i) % nx, (int(i) + 1) % nx
        low, high = self.first + int(j) * nx, self.first + min(int(j) + 1, ns - 1) * nx
        return [low + a, low + b, high + a, high + b], [(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]

    def nearest(self, place: tuple[float, ...], positions: np.ndarray) -> tuple[list[int], list[float]]:
        """The node nearest to an image point, of those on the near side, or to a world point."""
        nx, ns = self.grid
        v = positions[self.first : self.first + nx * ns].astype(float)
        if len(place) == 3:
            gap = np.linalg.norm(v - (np.array(place) - self.origin) / self.unit, axis=1)
        else:
            gap = np.linalg.norm(self.camera.project(v) - np.array(place), axis=1)
            far = self.camera.distance(v).reshape(ns, nx)
            gap[(far > far.mean(axis=1, keepdims=True) + 1e-6).ravel()] += np.ptp(gap) * 0.05
        return [self.first + int(gap.argmin())] * 4, [1.0, 0.0, 0.0, 0.0]


class Springs:
    """All springs of a model, in arrays that the captured graph reads; what changes with time is written from outside."""

    def __init__(self, bodies: list[Held], mass: np.ndarray, device: str):
        self.bodies, self.device = bodies, device
        self.owners = [body for body in bodies for _ in body.springs]
        self.list = [spring for body in bodies for spring in body.springs]
        self.tied: list[tuple[list[int], list[float]] | None] = [None] * len(self.list)
        self.way = [0.0] * len(self.list)
        """how far the object was from the anchor when the spring took hold [image px]."""
        self.array = wp.zeros(len(self.list), dtype=kernels.Spring, device=device)  # pyright: ignore
        self.mass = wp.array(mass.astype(np.float32), dtype=float, device=device)
        m = len(self.list)
        self.reply = wp.zeros((m, len(mass)), dtype=float, device=device)
        self.inverse, self.back = wp.zeros((m, m), dtype=float, device=device), wp.zeros(m, dtype=wp.vec3, device=device)
        self.iteration = -1

    def __len__(self) -> int:
        return len(self.list)

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

    def set(self, iteration: int, positions: np.ndarray) -> None:
        """Writes what holds at an iteration; those that take hold are tied where the object is now, positions (N, 3)."""
        self.iteration = iteration
        values = []
        for i, (spring, body) in enumerate(zip(self.list, self.owners, strict=True)):
            value = kernels.Spring()
            value.eye = body.eye if len(spring.anchor) == 2 else -1
            if len(spring.anchor) == 2:
                value.anchor = wp.vec3(*spring.anchor, 0.0)
            else:
                value.anchor = wp.vec3(*map(float, (np.array(spring.anchor) - body.origin) / body.unit))
            value.first, value.last = body.first, body.first + int(np.prod(body.grid))
            if spring.reach is not None:
                value.reach = spring.reach if len(spring.anchor) == 2 else spring.reach / body.unit
            value.density = 1 / float(np.prod(body.spacing))
            if spring.holds(iteration):
                value.stiffness = spring.stiffness
                if spring.reach is None:
                    tied = self.tied[i] or (
                        body.nodes(spring.point) if spring.point is not None else body.nearest(spring.near or (), positions)
                    )
                    if self.tied[i] is None:
                        self.tied[i] = tied
                        self.way[i] = float(np.linalg.norm(np.diff(self._segment(i, positions), axis=0)))
                    value.n0, value.n1, value.n2, value.n3 = tied[0]
                    value.weight = wp.vec4(*tied[1])
            else:
                self.tied[i] = None
            values.append(value)
        if values:
            self.array.assign(wp.array(values, dtype=kernels.Spring, device="cpu").numpy())

    def segments(self, k: int, positions: np.ndarray) -> list[np.ndarray]:
        """Springs that hold body k, from where they are tied to their anchors, image points (2, 2) each."""
        return [self._segment(i, positions) for i in self.holding(k)]

    def holding(self, k: int) -> list[int]:
        """Springs that hold body k now, volcanoes left out."""
        return [i for i, tied in enumerate(self.tied) if tied is not None and self.owners[i] is self.bodies[k]]

    def _segment(self, i: int, positions: np.ndarray) -> np.ndarray:
        (nodes, weights), body, anchor = self.tied[i] or ([], []), self.owners[i], np.array(self.list[i].anchor)
        if len(anchor) == 3:
            anchor = body.camera.project((anchor - body.origin) / body.unit)
        return np.stack([body.camera.project(np.array(weights) @ positions[nodes].astype(float)), anchor])

    def take_implicitly(self, step_under: Callable[[np.ndarray], np.ndarray]) -> None:
        """Makes `give_back` anew; to be called after `set`, and after material or time step changed.

        Args:
            step_under: what a solver's step does to nodes at rest, (N,), under loads per hx hs on them, (N,).
        """
        held = [i for i, spring in enumerate(self.list) if spring.reach is None and spring.holds(self.iteration)]
        reply, inverse = np.zeros(self.reply.shape), np.zeros(self.inverse.shape)
        hangs = np.zeros((len(held), self.reply.shape[1]))
        for row, i in enumerate(held):
            nodes, weights = self.tied[i] or ([], [])
            np.add.at(hangs[row], nodes, weights)
            reply[i] = step_under(hangs[row] / np.prod(self.owners[i].spacing))
        if held:
            stiffness = np.array([self.list[i].stiffness for i in held])
            inverse[np.ix_(held, held)] = np.linalg.inv(np.diag(1 / stiffness) + hangs @ reply[held].T)
        self.reply.assign(reply.astype(np.float32))
        self.inverse.assign(inverse.astype(np.float32))

    def give_back(self, nodes: wp.array, velocity: wp.array) -> None:
        """Makes the step just done, `velocity`, one that has the springs in its matrix: launches only."""
        if not self.list:
            return
        wp.launch(
            kernels.give_way,
            len(self.list),
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
        if not self.list:
            return
        wp.launch(
            kernels.spring_force, len(self.list), inputs=[self.array, eyes, nodes], outputs=[force], device=self.device
        )
        if any(spring.reach is not None for spring in self.list):
            wp.launch(
                kernels.volcano_force,
                len(force),
                inputs=[self.array, eyes, self.mass, nodes],
                outputs=[force],
                device=self.device,
            )
