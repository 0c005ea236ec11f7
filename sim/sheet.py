"""Snakes and open sheets laid out for the solver, and their step: grids that are open along s, closed or cut around x.

A model of its own beside `sim.model`, with its names, so that kernels and factors serve both: a sheet has no spine, no rings
that stay together and no occluding contour, and each object has its own unit of length and its own eyes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from ..kernels import image as image_kernels
from ..kernels import integrate, projection
from ..kernels import sheet as kernels
from .camera import Camera
from .curve import between, border, evenly, first_nodes, shoelace, size
from .model import eye_of
from .potential import PLAIN, RANGE, Potential, ScaleSpace
from .problem import Settings, Sheet, SheetMaterial, Snake, SnakeMaterial, View
from .region import no_map, region_map
from .solvers.adi import SolverADI
from .solvers.base import end_mass
from .solvers.factor import cyclic_bands, factor_cyclic
from .spring import Held, Springs

STEP = 2.0
"""Time step of what the image holds: its own stiffness, taken implicitly, makes that two thirds of the way."""
POINTS = 400
"""Points of an outline, or of a side of one, where the image is looked up: as many whatever the nodes."""
BEND = 2.5
"""Length over which a snake's own rigidity evens it out, the fourth root of w2 over the image's unit stiffness [sigmas]."""


class Sheets:
    """Model, state, potentials, springs of snakes and sheets; world units or image px outside, own units within.

    Attributes are those of `sim.model.Model` where they share a name; besides (P objects, C points of outlines):
        step: hx, hs, shape (P, 2); hs of a snake is 1.
        mass: share of a cell along x and s that belongs to a node, shape (N, 2).
        load: even force per unit of (x, s), shape (P, 3).
        share: load per hx hs of a line load of 1, shape (C,).
        outline: node, the one before, the one after, shape (C, 3); outline_tube: its object, shape (C,).
    """

    def __init__(self, views: list[View], objects: list[Snake | Sheet], settings: Settings, device: str):
        self.views, self.objects, self.settings, self.device = views, objects, settings, device
        self.grids = [(o.nodes, 1) if isinstance(o, Snake) else o.grid for o in objects]
        self.round = [isinstance(o, Snake) and o.closed for o in objects]
        self.node_start = np.concatenate([[0], np.cumsum([nx * ns for nx, ns in self.grids])])
        self.ring_start = np.concatenate([[0], np.cumsum([ns for _, ns in self.grids])])
        self.nodes, self.rings = int(self.node_start[-1]), int(self.ring_start[-1])
        self.spacing = [
            (1 / nx if closed else 1 / (nx - 1), 1 / (ns - 1) if ns > 1 else 1.0)
            for (nx, ns), closed in zip(self.grids, self.round, strict=True)
        ]
        first = [first_nodes(o, views[0].camera) for o in objects]
        self.units = [size(v, closed) for v, closed in zip(first, self.round, strict=True)]
        self.origins = [v.reshape(-1, 3).mean(axis=0) for v in first]
        px = Camera.orthographic()
        self.cameras = [
            (px if isinstance(o, Snake) else views[0].camera).in_units(u, c)
            for o, u, c in zip(objects, self.units, self.origins, strict=True)
        ]
        self.spaces = [self._space(o, v) for o, v in zip(objects, first, strict=True)]
        self._lay_out()
        self._place([(v - c) / u for v, u, c in zip(first, self.units, self.origins, strict=True)])
        bodies = [
            Held(list(o.springs), int(self.node_start[k]), self.grids[k], self.round[k], self.spacing[k],
                 self.units[k], self.origins[k], self.cameras[k], k)
            for k, o in enumerate(objects)
        ]  # fmt: skip
        self.springs = Springs(bodies, self.mass.numpy().prod(axis=1), device)
        self.sigmas = [0.0] * len(objects)
        self.set_material()

    def _space(self, o: Snake | Sheet, first: np.ndarray) -> ScaleSpace | None:
        """Potentials of the outline; of an open snake those of plain edges, in all colours."""
        view = self.views[0]
        if isinstance(o, Sheet):
            if not o.image:
                return None
            points, closed, camera = view.camera.project(border(first)), True, view.camera
        else:
            points, closed, camera = first[:, 0, :2], o.closed, Camera.orthographic()
        settings = self.settings if closed else replace(self.settings, potential="edges")
        mapped = settings.potential == "map"
        map_ = region_map(view.image, points, view.ignore, o.not_here) if mapped else no_map(view.image, points)
        return ScaleSpace(view, camera, map_, settings, plain=PLAIN)

    def _lay_out(self) -> None:
        ring_tube = np.repeat(np.arange(len(self.grids)), [ns for _, ns in self.grids])
        ring_nx = np.array([nx for nx, _ in self.grids])[ring_tube]
        deep = [k for k, (_, ns) in enumerate(self.grids) if ns > 1]
        mass, outline = [], []
        for k, (nx, ns) in enumerate(self.grids):
            along = end_mass(ns) if ns > 1 else np.ones(1)
            around = np.ones(nx) if self.round[k] else end_mass(nx)
            mass.append(np.stack([np.tile(around, ns), np.repeat(along, nx)], axis=1))
            if self.spaces[k] is not None:
                outline.append(self._outline(k))
        quadrature = [np.concatenate(each) for each in zip(*outline, strict=True)]
        nodes, place, way, share, owner = quadrature or (np.zeros((0, 4)), np.zeros((0, 4)), np.zeros((0, 4)), [], [])

        def ints(a: np.ndarray | list) -> wp.array:
            return wp.array(np.ascontiguousarray(a, np.int32), dtype=int, device=self.device)

        def vectors(n: int) -> wp.array:
            return wp.zeros(n, dtype=wp.vec3, device=self.device)

        def scalars(n: int) -> wp.array:
            return wp.zeros(n, dtype=float, device=self.device)

        self.node_ring, self.ring_tube = ints(np.repeat(np.arange(self.rings), ring_nx)), ints(ring_tube)
        self.ring_node = ints(np.concatenate([[0], np.cumsum(ring_nx)])[:-1])
        self.ring_s = ints(np.concatenate([np.arange(ns) for _, ns in self.grids]))
        self.ring_closed = ints(np.zeros(self.rings))
        self.tube_nx, self.tube_ns = ints([g[0] for g in self.grids]), ints([g[1] for g in self.grids])
        self.tube_node, self.tube_ring = ints(self.node_start[:-1]), ints(self.ring_start[:-1])
        self.seam = ints(self.round)
        self.line_tube = ints([k for k in deep for _ in range(self.grids[k][0])])
        self.line_x = ints([x for k in deep for x in range(self.grids[k][0])])
        self.outline, self.outline_tube = ints(nodes), ints(owner)
        self.place, self.along = (wp.array(a.astype(np.float32), dtype=wp.vec4, device=self.device) for a in (place, way))
        self.share = wp.array(np.asarray(share, np.float32), dtype=float, device=self.device)
        self.step = wp.array(np.array(self.spacing, np.float32), dtype=wp.vec2, device=self.device)
        self.mass = wp.array(np.concatenate(mass).astype(np.float32), dtype=wp.vec2, device=self.device)
        self.weights = {name: scalars(self.nodes) for name in ("w10", "w20", "w11", "w01", "w02")}
        self.k1, self.load = scalars(len(self.grids)), vectors(len(self.grids))
        self.dt = scalars(len(self.grids))
        self.eyes = wp.array([eye_of(c) for c in self.cameras], dtype=projection.Eye, device=self.device)
        sizes = [0 if space is None else int(np.prod(space.shape)) for space in self.spaces]
        self.sample_start = np.concatenate([[0], np.cumsum(sizes)])
        self.samples = wp.zeros(max(sum(sizes), 1), dtype=wp.vec4, device=self.device)
        self.fields = wp.zeros(len(self.grids), dtype=image_kernels.Field, device=self.device)  # pyright: ignore
        # state
        self.node, self.velocity, self.force, self.delta = (vectors(self.nodes) for _ in range(4))
        self.power, self.residuals = scalars(self.rings), scalars(self.rings)
        self.age, self.momentum, self.natural = (scalars(len(self.grids)) for _ in range(3))
        # factors
        self.x_factor = {
            "factor": vectors(self.nodes),
            "border": wp.zeros(self.nodes, dtype=wp.vec2, device=self.device),
            "corner": vectors(self.rings),
        }
        self.s_factor, self.unused = vectors(self.nodes), vectors(1)

    def _outline(self, k: int) -> tuple[np.ndarray, ...]:
        """Points of object k's outline: nodes, weights of place and direction, share, owner (see `outline_force`)."""
        (nx, ns), (hx, hs) = self.grids[k], self.spacing[k]
        if ns == 1:
            lines = [(np.arange(nx), hx)]
        else:
            grid = np.arange(nx * ns).reshape(ns, nx)
            lines = [(grid[0], hx), (grid[:, -1], hs), (grid[-1, ::-1], hx), (grid[::-1, 0], hs)]
            lines = lines if self._clockwise(k) else [(line[::-1], h) for line, h in lines]
        parts = []
        for line, h in lines:
            at, place, way = between(len(line), self.round[k], max(2, int(np.ceil(POINTS / len(line)))))
            share = np.full(len(at), h / (len(at) / (len(line) - (not self.round[k]))) / (hx * hs))
            parts.append((self.node_start[k] + line[at], place, way, share, np.full(len(at), k)))
        nodes, place, way, share, owner = (np.concatenate(each) for each in zip(*parts, strict=True))
        return nodes, place, way, share, owner

    def _clockwise(self, k: int) -> bool:
        """Whether a sheet's border runs clockwise as the view sees it first."""
        o = self.objects[k]
        assert isinstance(o, Sheet)
        corners = np.asarray(o.corners, float)
        points = corners if corners.shape[1] == 2 else self.views[0].camera.project(corners)
        return shoelace(points) > 0

    def set_material(self) -> None:
        """Writes weights and factors."""
        flat = {name: np.zeros(self.nodes) for name in self.weights}
        x = {"factor": np.zeros((self.nodes, 3)), "border": np.zeros((self.nodes, 2)), "corner": np.zeros((self.rings, 3))}
        s = np.zeros((self.nodes, 3))
        k1, load, dt = np.zeros(len(self.grids)), np.zeros((len(self.grids), 3)), np.zeros(len(self.grids))
        for k, o in enumerate(self.objects):
            (nx, ns), nodes, rings = self.grids[k], self.nodes_of(k), self.rings_of(k)
            if isinstance(o.material, SnakeMaterial):
                values = {"w10": o.material.w1, "w20": self._bend(k) if o.material.w2 is None else o.material.w2}
                k1[k], dt[k] = o.material.k1, STEP
            else:
                values = {name: getattr(o.material, name) for name in self.weights}
                dt[k] = STEP if self.sigmas[k] > 0 else self._long_step(o.material)
            if isinstance(o, Sheet):
                load[k] = np.array(o.load) / self.units[k]
            if self.settings.step is not None:
                dt[k] = self.settings.step
            grid = {name: np.full((ns, nx), values.get(name, 0.0)) for name in self.weights}
            if not self.round[k]:  # the cut
                grid["w10"][:, -1] = grid["w11"][:, -1] = grid["w20"][:, 0] = grid["w20"][:, -1] = 0.0
            for name in grid:
                flat[name][nodes] = grid[name].ravel()
            # what twists is stiff too, and no line has it: as much again for the lines, at most
            twice = 1 + bool(np.any(grid["w11"]))
            hx, hs = self.spacing[k]
            across, along = grid["w10"] + 2 * k1[k] * self._uncut(k), grid["w01"].T
            diagonal, first, second = (twice * band for band in cyclic_bands(across, grid["w20"], hx))
            # the image's own stiffness: all along a snake, at the ends of a sheet's lines
            hold, around = self.settings.gain * (self.sigmas[k] > 0), self.mass.numpy()[nodes].reshape(ns, nx, 2)[..., 0]
            diagonal = diagonal + hold * (around if ns == 1 else 2 * (1 - around) / hx)
            factors = factor_cyclic(around + dt[k] * diagonal, dt[k] * first, dt[k] * second)
            x["factor"][nodes], x["border"][nodes] = factors["factor"].reshape(-1, 3), factors["border"].reshape(-1, 2)
            x["corner"][rings] = factors["corner"]
            if ns > 1:
                ends = hold * 4 * (1 - end_mass(ns)) / hs
                lines = SolverADI._along(twice * along, twice * grid["w02"].T, dt[k], False, extra=ends)
                s[nodes] = lines.transpose(1, 0, 2).reshape(-1, 3)
        for arrays, host in ((self.weights, flat), (self.x_factor, x)):
            for name, array in arrays.items():
                array.assign(host[name].astype(np.float32))
        self.s_factor.assign(s.astype(np.float32))
        for array, values in ((self.k1, k1), (self.load, load), (self.dt, dt)):
            array.assign(values.astype(np.float32))
        self.springs.take_implicitly(self._step_under)

    def _bend(self, k: int) -> np.ndarray:
        """Rigidity of a snake's nodes, as far as the image is smoothed, and beside springs as far as they pull."""
        n, first = self.grids[k][0], int(self.node_start[k])
        bend = np.full(n, float(self.sigmas[k]))
        for i in self.springs.holding(k):
            nodes, _ = self.springs.tied[i] or ([first], [])
            apart = np.abs(np.arange(n) - (nodes[0] - first))
            apart = np.minimum(apart, n - apart) if self.round[k] else apart
            near = np.exp(-((apart * self.spacing[k][0] / self.pixel(k) / max(self.springs.way[i], 1.0)) ** 2))
            bend = np.maximum(bend, near * self.springs.way[i] / (2 * RANGE))
        return (BEND * bend * self.pixel(k)) ** 4

    def _step_under(self, load: np.ndarray) -> np.ndarray:
        """Step of nodes at rest under a load, both (N,) and in one direction."""
        dt = np.repeat(self.dt.numpy(), np.diff(self.node_start))
        self.delta.assign(((dt * load)[:, None] * [1.0, 0.0, 0.0]).astype(np.float32))
        self._solve_lines()
        return self.delta.numpy()[:, 0].astype(float)

    def _uncut(self, k: int) -> np.ndarray:
        """1 on the edges of object k's lines, 0 on the one that a cut takes away, shape (N_x,)."""
        edges = np.ones(self.grids[k][0])
        edges[-1] = self.round[k]
        return edges

    @staticmethod
    def _long_step(m: SheetMaterial) -> float:
        """As far as a sheet's own slow modes bear: those that twist it, which no line resists, move by 288 w11 dt."""
        slowest = np.pi**2 * max(m.w10, m.w01) + np.pi**4 * max(m.w20, m.w02)
        return min(max(STEP, 1 / max(slowest, 1e-9)), 1 / max(288 * m.w11, 1e-9), 1e4)

    def set_potentials(self, potentials: list[Potential | None]) -> None:
        """Hands the potentials of one scale to the kernels, and makes the factors anew."""
        samples = np.zeros((len(self.samples), 4), np.float32)
        fields = []
        for k, p in enumerate(potentials):
            f = image_kernels.Field()
            if p is not None:
                self.sigmas[k] = p.sigma
                h, w = p.magnitude.shape
                start = int(self.sample_start[k])
                each = p.samples.copy()
                # beyond its border a field has no force, or what has turned inside out there would go on and on
                each[[0, -1]] = each[:, [0, -1]] = 0.0
                samples[start : start + h * w] = each.reshape(-1, 4)
                f.start, f.width, f.height = start, w, h
                f.x0, f.y0, f.step, f.gain = *p.origin, p.step, self.settings.gain
                f.first, f.last = wp.vec2(-1e6), wp.vec2(1e6)
                if self.settings.force == "paper":
                    f.gain *= self.pixel(k) ** 2
            fields.append(f)
        self.samples.assign(samples)
        self.fields.assign(wp.array(fields, dtype=image_kernels.Field, device="cpu").numpy())
        self.set_material()

    def pixel(self, k: int) -> float:
        """Own length of a pixel at the middle of object k."""
        step = 1e-3
        gap = self.cameras[k].project(step * np.eye(3)) - self.cameras[k].project(np.zeros(3))
        return step / float(np.linalg.norm(gap, axis=1).max())

    def iterate(self) -> None:
        """One implicit step of (10), mu = 0 and gamma = 1: launches only, so that it can be captured."""
        ring = [self.ring_tube, self.ring_node, self.tube_nx]
        wp.launch(
            kernels.mean_edges,
            len(self.grids),
            inputs=[self.tube_node, self.tube_nx, self.tube_ns, self.seam, self.node],
            outputs=[self.natural],
            device=self.device,
        )
        wp.launch(
            kernels.sheet_force,
            self.nodes,
            inputs=[
                self.node_ring, *ring[:2], self.ring_s, self.tube_nx, self.tube_ns, self.step, self.mass,
                *self.weights.values(), self.k1, self.load, self.seam, self.node, self.natural,
            ],
            outputs=[self.force],
            device=self.device,
        )  # fmt: skip
        if len(self.outline):
            literal = int(self.settings.force == "paper")
            wp.launch(
                kernels.outline_force,
                len(self.outline),
                inputs=[
                    self.outline, self.place, self.along, self.share, self.outline_tube, self.eyes, self.fields,
                    self.samples, self.node, literal,
                ],
                outputs=[self.force],
                device=self.device,
            )  # fmt: skip
        self.springs.add_forces(self.eyes, self.node, self.force)
        wp.launch(
            kernels.scale_force,
            self.rings,
            inputs=[*ring, self.dt, self.force, self.velocity],
            outputs=[self.delta, self.power],
            device=self.device,
        )
        self._solve_lines()
        wp.launch(
            integrate.gather_momentum,
            len(self.grids),
            inputs=[self.tube_ring, self.tube_ns, self.power, self.settings.momentum],
            outputs=[self.age, self.momentum],
            device=self.device,
        )
        wp.launch(
            kernels.advance,
            self.rings,
            inputs=[*ring, self.dt, self.delta, self.momentum],
            outputs=[self.node, self.velocity, self.residuals],
            device=self.device,
        )
        self.springs.give_back(self.node, self.velocity)

    def _solve_lines(self) -> None:
        """Turns dt R in `delta` into the step, in place: the two sweeps of the ADI step (section 5)."""
        wp.launch(
            integrate.sweep_rings,
            self.rings,
            inputs=[self.ring_tube, self.ring_node, self.tube_nx, self.ring_closed, *self.x_factor.values()],
            outputs=[self.delta],
            device=self.device,
        )
        if len(self.line_x):
            wp.launch(
                integrate.sweep_meridians,
                len(self.line_x),
                inputs=[
                    self.line_tube, self.line_x, self.tube_nx, self.tube_ns, self.tube_node, self.tube_ring,
                    self.s_factor, self.unused, self.rings,
                ],
                outputs=[self.delta, self.force],
                device=self.device,
            )  # fmt: skip

    def deal(self) -> None:
        """Spaces the nodes of every snake evenly along it."""
        values = [self.own(k) for k in range(len(self.grids))]
        for k, o in enumerate(self.objects):
            if isinstance(o, Snake):
                values[k] = evenly(values[k][:, 0], o.nodes, o.closed)[:, None]
        self._place(values)

    def _place(self, values: list[np.ndarray]) -> None:
        flat = [v.transpose(1, 0, 2).reshape(-1, 3) for v in values]
        self.rewind(np.concatenate(flat).astype(np.float32))

    def rewind(self, positions: np.ndarray) -> None:
        """Puts all nodes to positions, shape (N, 3), at rest."""
        self.node.assign(positions)
        self.velocity.zero_()
        self.age.zero_()

    def own(self, k: int) -> np.ndarray:
        """Nodes of object k in own units, shape (N_x, N_s, 3)."""
        nx, ns = self.grids[k]
        return self.node.numpy()[self.nodes_of(k)].reshape(ns, nx, 3).transpose(1, 0, 2).astype(float)

    def world(self, k: int) -> np.ndarray:
        """Nodes of object k, shape (N_x, N_s, 3): of a snake image px, of a sheet world units."""
        return self.own(k) * self.units[k] + self.origins[k]

    def pulls(self, k: int) -> list[np.ndarray]:
        """Springs that hold object k now, from it to their anchors, segments (2, 2) of image points."""
        return self.springs.segments(k, self.node.numpy())

    def residual(self) -> float:
        """Root mean square of the step over dt, all rings [own units]."""
        return float(np.sqrt(self.residuals.numpy().mean()))

    def nodes_of(self, k: int) -> slice:
        """Nodes of object k in the flat arrays."""
        return slice(int(self.node_start[k]), int(self.node_start[k + 1]))

    def rings_of(self, k: int) -> slice:
        """Rings of object k in the flat arrays."""
        return slice(int(self.ring_start[k]), int(self.ring_start[k + 1]))
