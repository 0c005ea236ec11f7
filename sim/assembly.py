"""A scene laid out for the solver: maps, scale spaces, flat arrays, the first tubes, and what changes between scales."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import image as image_kernels
from .camera import Camera
from .foreground import Foreground, axis_curve, foreground, length_of
from .initial import deal, fading, initial_tube, lift
from .model import Model, State
from .potential import Potential, ScaleSpace
from .problem import Settings, Tube, View

LINE_LOAD = 0.04
"""Stiffness of the contour: force a displacement for each unit of contour length and of s."""


class Assembly:
    """Maps, model and state of a problem; world units outside, initial spine lengths of the first tube within."""

    def __init__(self, views: list[View], tubes: list[Tube], settings: Settings, device: str):
        self.views, self.tubes, self.settings, self.device = views, tubes, settings, device
        camera = views[0].camera
        self.maps: list[Foreground] = []
        self.spaces: list[ScaleSpace] = []
        self.axes: list[np.ndarray] = []
        for tube in tubes:
            spine = np.asarray(tube.spine, float)
            flat = spine if spine.shape[1] == 2 else camera.project(spine)
            self.axes.append(lift(spine, camera, tube.depth) if spine.shape[1] == 2 else spine)
            map_ = foreground(views[0].image, flat, views[0].ignore, tube.not_here)
            self.maps.append(map_)
            self.spaces.append(ScaleSpace(views[0], camera, map_, settings))
        self.lengths = [length_of(axis_curve(a)) for a in self.axes]
        self.unit = self.lengths[0]
        self.origin = axis_curve(self.axes[0]).mean(axis=0)
        sizes = [int(np.prod(s.shape)) for s in self.spaces]
        self.sample_start = np.concatenate([[0], np.cumsum(sizes)])
        self.model = Model([t.grid for t in tubes], [t.material.closed for t in tubes], len(views), sum(sizes), device)
        self.model.set_cameras([self._own_camera(v.camera) for v in views])
        self.model.image_load[:] = settings.gain * LINE_LOAD
        self.state = State(self.model)
        self._start()

    def _own_camera(self, camera: Camera) -> Camera:
        """A camera that takes points in the model's units."""
        change = np.eye(4)
        change[:3, :3] *= self.unit
        change[:3, 3] = self.origin
        return Camera(camera.matrix @ change)

    def _start(self) -> None:
        tube_flat, spine_flat = np.zeros((self.model.nodes, 3)), np.zeros((self.model.rings, 3))
        for k, tube in enumerate(self.tubes):
            axis = (self._carried_on(k) - self.origin) / self.unit
            radius = tube.radius or 0.5 * self.maps[k].half_width * self._pixel(k)
            nodes, spine = initial_tube(axis, radius / self.unit, tube.grid, tube.material.closed)
            tube_flat[self.model.nodes_of(k)] = nodes.transpose(1, 0, 2).reshape(-1, 3)
            spine_flat[self.model.rings_of(k)] = spine
        self.state.tube.assign(tube_flat.astype(np.float32))
        self.state.spine.assign(spine_flat.astype(np.float32))

    def _pixel(self, k: int) -> float:
        """World length of a pixel of the first view at the middle of object k's axis."""
        camera, middle, step = self.views[0].camera, self.axes[k].mean(axis=0), 1e-3 * self.unit
        return step / np.linalg.norm(camera.project(middle + step * np.eye(3)) - camera.project(middle), axis=1).max()

    def _carried_on(self, k: int) -> np.ndarray:
        """The rough axis in the world, as far as the map's object reaches; straight beyond its own ends."""
        if self.settings.potential != "map":
            return self.axes[k]
        camera, flat = self.views[0].camera, self.maps[k].axis
        axis = axis_curve(self.axes[k])
        long = np.concatenate([2 * axis[0] - axis[::-1], axis, 2 * axis[-1] - axis[::-1]])
        gap = flat[:, None] - camera.project(long)[None]
        near = long[(gap**2).sum(-1).argmin(axis=1)]
        # each image point's line of sight, where it is as deep as the rough axis
        sight, m = camera.sight(near), camera.matrix
        sides = np.concatenate([m[:2, :3] - flat[..., None] * m[2, :3], sight[:, None]], axis=1)
        heights = np.column_stack([flat * m[2, 3] - m[:2, 3], (sight * near).sum(axis=1)])
        return np.linalg.solve(sides, heights[..., None])[..., 0]

    def world(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Tube (N_x, N_s, 3) and spine (N_s, 3) of object k in world units."""
        nx, ns = self.tubes[k].grid
        tube = self.state.tube.numpy()[self.model.nodes_of(k)].reshape(ns, nx, 3).transpose(1, 0, 2)
        spine = self.state.spine.numpy()[self.model.rings_of(k)]
        return tube * float(self.unit) + self.origin, spine * float(self.unit) + self.origin

    def velocity(self, k: int) -> np.ndarray:
        """Velocity of tube k with mass, shape (N_x, N_s, 3), world units per unit of time; 0 without mass."""
        (nx, ns), nodes = self.tubes[k].grid, self.model.nodes_of(k)
        if not self.model.mu.numpy().any():
            return np.zeros((nx, ns, 3))
        return self.state.velocity.numpy()[nodes].reshape(ns, nx, 3).transpose(1, 0, 2) * float(self.unit)

    def set_material(self, share: float) -> None:
        """Writes the weights; `share` of the rigidities that falls with sigma (continuation)."""
        m = self.model
        node = {n: np.zeros(m.nodes, np.float32) for n in ("w10", "w20", "w11", "w01", "w02", "mu", "gamma")}
        ring = {n: np.zeros(m.rings, np.float32) for n in ("w1", "w2", "spine_mu", "spine_gamma")}
        coupling = np.zeros((m.rings, 8), np.float32)
        for k, tube in enumerate(self.tubes):
            mat, nodes, rings = tube.material, m.nodes_of(k), m.rings_of(k)
            for n in ("w10", "w20", "w11", "w01", "mu", "gamma"):
                node[n][nodes] = getattr(mat, n)
            ring["spine_mu"][rings], ring["spine_gamma"][rings] = mat.mu, mat.gamma
            node["w02"][nodes] = mat.w02 * share
            ring["w1"][rings], ring["w2"][rings] = mat.w1, mat.w2 * share
            lap = (2 * np.sin(np.pi / tube.grid[0]) * tube.grid[0]) ** 2
            depth = mat.depth if len(self.views) == 1 else 0.0
            balance = mat.c_balance * (mat.w10 * lap + mat.w20 * lap**2)
            coupling[rings] = [mat.a, mat.a * mat.reaction, mat.b, mat.c, balance, mat.d, mat.centre, depth]
        m.k1.assign(np.array([t.material.k1 for t in self.tubes], np.float32))
        for name, value in (*node.items(), *ring.items(), ("coupling", coupling)):
            getattr(m, name).assign(value)

    def hold_depth(self) -> None:
        """Writes the depth each ring is held at: the rough axis' own, going on straight beyond its ends."""
        camera = self._own_camera(self.views[0].camera)
        rest = np.zeros(self.model.rings, np.float32)
        spine = self.state.spine.numpy()
        for k in range(len(self.tubes)):
            axis = axis_curve((self.axes[k] - self.origin) / self.unit)
            long = np.concatenate([2 * axis[0] - axis[::-1], axis, 2 * axis[-1] - axis[::-1]])
            rings = self.model.rings_of(k)
            gap = camera.project(spine[rings])[:, None] - camera.project(long)[None]
            rest[rings] = camera.distance(long)[(gap**2).sum(-1).argmin(axis=1)]
        self.model.depth_rest.assign(rest)

    def deal(self) -> None:
        """Deals the rings of every tube out anew."""
        tubes, spines = self.positions()
        for k, tube in enumerate(self.tubes):
            nx, ns = tube.grid
            nodes, rings = self.model.nodes_of(k), self.model.rings_of(k)
            grid, spines[rings] = deal(tubes[nodes].reshape(ns, nx, 3).transpose(1, 0, 2), spines[rings])
            tubes[nodes] = grid.transpose(1, 0, 2).reshape(-1, 3)
        self.rewind((tubes, spines))

    def hold_tangents(self) -> None:
        """Writes how far along the spine each ring's tangent looks."""
        far = np.zeros(self.model.rings)
        tubes, spines = self.positions()
        for k, tube in enumerate(self.tubes):
            nx, ns = tube.grid
            rings = self.model.rings_of(k)
            far[rings] = fading(tubes[self.model.nodes_of(k)].reshape(ns, nx, 3).transpose(1, 0, 2), spines[rings])
        self.model.ring_far.assign((far[:, None] ** np.arange(self.model.ring_far.shape[1])).astype(np.float32))

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Tube and spine nodes as they are now, to go back to with `rewind`."""
        return self.state.tube.numpy().copy(), self.state.spine.numpy().copy()

    def moved(self, before: np.ndarray) -> float:
        """Longest way since tube nodes were at `before`: of nodes across the surface, of closed ends in any direction."""
        way = self.state.tube.numpy() - before
        across = np.abs((way * self.state.normal.numpy()).sum(axis=1)).max()
        ends = self.model.host_ring_closed[self.model.node_ring.numpy()]
        return float(max(across, np.linalg.norm(way[ends], axis=1).max(initial=0.0)))

    def rewind(self, positions: tuple[np.ndarray, np.ndarray]) -> None:
        """Goes back to `positions`, at rest."""
        self.state.tube.assign(positions[0])
        self.state.spine.assign(positions[1])
        self.stand_still()

    def stand_still(self) -> None:
        """Forgets the steps before, so that momentum does not carry over to another potential."""
        self.state.age.zero_()
        self.state.velocity.zero_()
        self.state.spine_velocity.zero_()

    def set_potentials(self, potentials: list[Potential]) -> None:
        """Hands the potentials of one scale to the kernels, one for each tube."""
        samples = np.zeros((len(self.model.samples), 4), np.float32)
        fields = []
        for k, p in enumerate(potentials):
            h, w = p.magnitude.shape
            start = int(self.sample_start[k])
            samples[start : start + h * w] = p.samples.reshape(-1, 4)
            f = image_kernels.Field()
            f.start, f.width, f.height = start, w, h
            f.x0, f.y0, f.step = *p.origin, p.step
            # contour length counts in lengths of the tube's own spine
            f.gain = self.settings.gain * LINE_LOAD * self.unit / self.lengths[k]
            if self.settings.force == "paper":
                # the chain rule of (11) yields px a length where a displacement is a length a px
                f.gain *= (self._pixel(k) / self.unit) ** 2
            fields.append([f])
        self.model.samples.assign(samples)
        host = wp.array([f[0] for f in fields], dtype=image_kernels.Field, device="cpu").numpy()
        self.model.fields.assign(host.reshape(len(potentials), 1))
