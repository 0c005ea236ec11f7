"""A scene laid out for the solver: maps, scale spaces, flat arrays, the first tubes, and what changes between scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from ..kernels import image as image_kernels
from .beyond import unseen
from .camera import Camera
from .fabric import Fabric
from .fields import joined, marks
from .foreground import Foreground, axis_curve, length_of
from .guide import LEAST, MODES, SMOOTH, course, ends, weakest
from .hidden import Hidden, clear_of
from .initial import deal, fading, initial_tube, lift
from .model import Model
from .neighbours import foregrounds
from .potential import Potential, ScaleSpace
from .problem import Settings, Tube, View
from .sights import common_axis, pixel_size, spread, stiffness, untold
from .solvers.base import end_mass
from .spring import Held, Springs

LINE_LOAD = 0.04
"""Stiffness of the contour: force a displacement for each unit of contour length and of s."""
SQUAT, STIFF = 2.6, 3e-6
"""Widths of a tube's length below which, in several views, it begins stiffer, by so much w02 times the fourth power of that,
less one: its end rings, so close together, would grow past the object and fold over the poles that are still inside it."""


def maps_of(views: list[View], tubes: list[Tube]) -> list[list[Foreground]]:
    """The foreground maps of each tube, one for each view; marks are of the first."""
    given = [np.asarray(tube.spine, float) for tube in tubes]
    maps = []
    for v, view in enumerate(views):
        world = [
            lift(spine, views[0].camera, tube.depth) if v > 0 and spine.shape[1] == 2 else spine
            for spine, tube in zip(given, tubes, strict=True)
        ]
        flat = [spine if spine.shape[1] == 2 else view.camera.project(spine) for spine in world]
        depths = [
            tube.depth if spine.shape[1] == 2 else float(view.camera.distance(spine).mean())
            for spine, tube in zip(world, tubes, strict=True)
        ]
        marks = [tube.not_here if v == 0 else None for tube in tubes]
        maps.append(foregrounds(view, flat, marks, depths, [tube.goes_on for tube in tubes]))
    return [list(row) for row in zip(*maps, strict=True)]


def _of_view(settings: Settings, row: list[Foreground], map_: Foreground) -> Settings:
    """Settings whose sigmas, which are in pixels of the first view, are in those of the map's view."""
    if settings.sigmas is None:
        return settings
    return replace(settings, sigmas=tuple(s * map_.half_width / row[0].half_width for s in settings.sigmas))


class Assembly(Fabric):
    """Scale spaces, model and state of some tubes; world units outside, initial spine lengths of the first within.

    Attributes:
        own_views: of each tube, what it must not look at left out.
        hidden, meetings: where each tube is hidden in each view, and where outlines of what lies behind meet its own, image
            points (n, 2): by `visibility.Visibility`.
        smooth: of the courses of spines, see `guide.SMOOTH`.
    """

    def __init__(self, views: list[View], tubes: list[Tube], settings: Settings, device: str, maps: list[list[Foreground]]):
        self.views, self.maps, self.smooth = views, maps, SMOOTH
        camera = views[0].camera
        spines = [np.asarray(tube.spine, float) for tube in tubes]
        self.axes = [
            lift(spine, camera, tube.depth) if spine.shape[1] == 2 else spine
            for spine, tube in zip(spines, tubes, strict=True)
        ]
        self.own_views = [
            [replace(v, ignore=unseen(v.ignore, v.camera.project(a), t.goes_on, v.image.shape)) for v in views]
            for t, a in zip(tubes, self.axes, strict=True)
        ]
        self.spaces = [
            [ScaleSpace(view, view.camera, m, _of_view(settings, row, m)) for view, m in zip(own, row, strict=True)]
            for own, row in zip(self.own_views, maps, strict=True)
        ]
        self.lengths = [length_of(axis_curve(a)) for a in self.axes]
        sizes = [int(np.prod(s.shape)) for row in self.spaces for s in row]
        self.hidden: list[list[Hidden | None]] = [[Hidden.of(view.ignore) for view in own] for own in self.own_views]
        self.meetings: list[list[np.ndarray]] = [[np.zeros((0, 2)) for _ in views] for _ in tubes]
        self.others: list[list[Hidden | None]] = [[None] * len(views) for _ in tubes]
        model = Model([t.grid for t in tubes], [t.material.closed for t in tubes], len(views), sum(sizes), device)
        super().__init__(model, tubes, settings, device, self.lengths[0], axis_curve(self.axes[0]).mean(axis=0))
        self.model.set_cameras([self.own_camera(v.camera) for v in views])
        self._look()
        self.model.image_load[:] = settings.gain * LINE_LOAD
        self._start()
        own, *others = (self.own_camera(view.camera) for view in views)
        others = tuple(others)
        bodies = [
            Held([s for s in t.springs if not s.frame], int(self.model.node_start[k]), t.grid, True,
                 (1 / t.grid[0], 1 / (t.grid[1] - 1)), self.unit, self.origin, own, 0, others)
            for k, t in enumerate(tubes)
        ]  # fmt: skip
        mass = np.concatenate([np.repeat(end_mass(ns), nx) for nx, ns in self.model.grids])
        self.springs = Springs(bodies, mass, device)

    def own_camera(self, camera: Camera) -> Camera:
        """A camera that takes points in the model's units."""
        return camera.in_units(self.unit, self.origin)

    def _start(self) -> None:
        tube_flat, spine_flat = np.zeros((self.model.nodes, 3)), np.zeros((self.model.rings, 3))
        for k, tube in enumerate(self.tubes):
            carried = self._carried_on(k)
            if len(self.views) > 1:
                self.axes[k] = carried
            breaks = [replace(b, at=self._share(b.at, carried, tube.grid[1])) for b in tube.breaks]
            self.weights.breaks[k] = breaks
            if len(self.views) > 1:
                slender = length_of(carried) / (4 * self._radius(k))
                self.weights.stiffer[k] = STIFF * (max(1.0, SQUAT / slender) ** 4 - 1)
            radius = tube.radius or self._radius(k)
            axis, where = (carried - self.origin) / self.unit, marks(breaks, tube.grid[1])
            nodes, spine = initial_tube(axis, radius / self.unit, tube.grid, tube.material.closed, where)
            tube_flat[self.model.nodes_of(k)] = nodes.transpose(1, 0, 2).reshape(-1, 3)
            spine_flat[self.model.rings_of(k)] = spine
        self.state.tube.assign(tube_flat.astype(np.float32))
        self.state.spine.assign(spine_flat.astype(np.float32))

    def _share(self, at: float | tuple[float, float], axis: np.ndarray, ns: int) -> float:
        """Share of the axis' length at a break, given so or by an image point, with room for a ring before and after it."""
        if not isinstance(at, int | float):
            fine = axis_curve(axis)
            gap = self.views[0].camera.project(fine) - np.asarray(at, float)
            at = float((gap**2).sum(axis=1).argmin() / (len(fine) - 1))
        return min(max(at, 1 / (ns - 1)), 1 - 1 / (ns - 1))

    def _pixel(self, k: int, v: int) -> float:
        """World length of a pixel of view v at the middle of object k's axis."""
        return pixel_size(self.views[v].camera, self.axes[k].mean(axis=0), 1e-3 * self.unit)

    def _radius(self, k: int) -> float:
        """Of the first tube: half of how wide the maps' object is."""
        return float(np.mean([0.5 * m.half_width * self._pixel(k, v) for v, m in enumerate(self.maps[k])]))

    def slender(self, k: int) -> float:
        """Length of the axis on which tube k's maps were made, in widths of their object."""
        return max(m.length / (2 * m.half_width) for m in self.maps[k])

    def _look(self) -> None:
        """Shares the pull on each tube out over the views, by the areas of their pixels."""
        pixels = np.array([[self._pixel(k, v) for v in range(len(self.views))] for k in range(len(self.tubes))])
        self.share = (pixels.min(axis=1, keepdims=True) / pixels) ** 2

    def _spread(self) -> None:
        """Writes how each ring's pull is spread over directions, by where it is now; and whose depth the views tell."""
        if len(self.views) == 1 or self.settings.force == "paper":
            return
        where = self.state.spine.numpy() * self.unit + self.origin
        sights = np.stack([view.camera.sight(where) for view in self.views], axis=1)
        by_node, by_ring, told = spread(sights, self.share[self.model.host_ring_tube])
        self.model.spread.assign(by_node.astype(np.float32))
        # at coarse scale the shape is none yet whose outlines tell depth
        self.model.boost.assign(((1 - self.weights.share) * by_ring).astype(np.float32))
        for k in range(len(self.tubes)):
            rings = self.model.rings_of(k)
            self.weights.told[k] = bool(told[rings].all())
            self.weights.untold[k] = untold(sights[rings], where[rings])

    def _carried_on(self, k: int) -> np.ndarray:
        """The rough axis in the world, as far as the map's object reaches; straight beyond its own ends."""
        if self.settings.potential != "map":
            return self.axes[k]
        if len(self.views) > 1:
            cameras = [view.camera for view in self.views]
            return common_axis(self.axes[k], cameras, [m.axis for m in self.maps[k]], self.slender(k))
        camera, flat = self.views[0].camera, self.maps[k][0].axis
        axis = axis_curve(self.axes[k])
        long = np.concatenate([2 * axis[0] - axis[::-1], axis, 2 * axis[-1] - axis[::-1]])
        gap = flat[:, None] - camera.project(long)[None]
        near = long[(gap**2).sum(-1).argmin(axis=1)]
        # each image point's line of sight, where it is as deep as the rough axis
        sight, m = camera.sight(near), camera.matrix
        sides = np.concatenate([m[:2, :3] - flat[..., None] * m[2, :3], sight[:, None]], axis=1)
        heights = np.column_stack([flat * m[2, 3] - m[:2, 3], (sight * near).sum(axis=1)])
        return np.linalg.solve(sides, heights[..., None])[..., 0]

    def hold_depth(self) -> None:
        """Writes the depth each ring is held at: the rough axis' own, going on straight beyond its ends."""
        camera = self.own_camera(self.views[0].camera)
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
            cuts = joined(self.weights.cuts[k], self.weights.spine_cuts[k])
            grid, spines[rings] = deal(tubes[nodes].reshape(ns, nx, 3).transpose(1, 0, 2), spines[rings], cuts)
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
        self._lead()
        self.model.ring_far.assign((far[:, None] ** np.arange(self.model.ring_far.shape[1])).astype(np.float32))

    def _lead(self) -> None:
        """Writes where spines lead that are seen from almost one side (`guide`)."""
        if len(self.views) == 1 or self.settings.force == "paper":
            return
        tubes, spines = self.positions()
        where = spines * self.unit + self.origin
        sights = np.stack([view.camera.sight(where) for view in self.views], axis=1)
        weak = weakest(*stiffness(sights, self.share[self.model.host_ring_tube]))
        modes, say = np.zeros((self.model.rings, MODES)), np.zeros(self.model.rings)
        for k, (nx, ns) in enumerate(self.model.grids):
            rings = self.model.rings_of(k)
            own = tubes[self.model.nodes_of(k)].reshape(ns, nx, 3)
            radius = np.linalg.norm(own - own.mean(axis=1, keepdims=True), axis=2).mean(axis=1)
            # the first tube is thinner than the object
            least = self._radius(k) / self.unit if self.weights.share == 1 else 0.0
            body = np.ones(ns)
            if self.tubes[k].material.closed and not any(self.tubes[k].goes_on):  # where it goes on is no end to be led
                body = ends(spines[rings], np.maximum(radius, least)) ** 2
            own_say = LEAST + (1 - LEAST) * body
            weak[rings] *= np.sqrt(1 - own_say)[:, None]
            modes[rings], say[rings] = course(spines[rings], radius, own_say, self.smooth)
        self.model.weak.assign(weak.astype(np.float32))
        self.model.course_modes.assign(modes.astype(np.float32))
        self.model.course_say.assign(say.astype(np.float32))

    def hold_shares(self, stiffness: float) -> None:
        """Lets nodes keep the shares of the meridians, their ways from ring to ring, that they have now."""
        hold, slack = np.zeros(self.model.nodes), np.zeros(self.model.rings)
        tubes = self.state.tube.numpy()
        for k, (nx, ns) in enumerate(self.model.grids):
            edges = np.linalg.norm(np.diff(tubes[self.model.nodes_of(k)].reshape(ns, nx, 3), axis=0), axis=2)
            share = np.maximum(edges / edges.mean(axis=1).sum(), 1e-3)
            hold[self.model.nodes_of(k)][:-nx] = stiffness / share.ravel()
            slack[self.model.rings_of(k)][:-1] = share.mean(axis=1) / stiffness
        self.model.edge_hold.assign(hold.astype(np.float32))
        self.model.ring_slack.assign(slack.astype(np.float32))

    def moved(self, before: np.ndarray) -> float:
        """Longest way since tube nodes were at `before`: of nodes across the surface, of closed ends in any direction.

        What lies beyond the image does not count: nothing is known of it.
        """
        now = self.state.tube.numpy()
        way = np.where(self._seen(now)[:, None], now - before, 0.0)
        across = np.abs((way * self.state.normal.numpy()).sum(axis=1)).max()
        ends = self.model.host_ring_closed[self.model.node_ring.numpy()]
        return float(max(across, np.linalg.norm(way[ends], axis=1).max(initial=0.0)))

    @property
    def leaves(self) -> bool:
        """Whether any closed end lies beyond the image, of several views beyond all, or where the object goes on."""
        if any(any(tube.goes_on) for tube in self.tubes):
            return True
        ends = self.model.host_ring_closed[self.model.node_ring.numpy()]
        return not bool(self._seen(self.state.tube.numpy()[ends]).all())

    def _seen(self, nodes: np.ndarray) -> np.ndarray:
        """Which nodes, shape (N, 3), own units, lie in the image of any view."""
        seen = np.zeros(len(nodes), bool)
        for view in self.views:
            h, w = view.image.shape[:2]
            points = self.own_camera(view.camera).project(nodes)
            seen |= np.all((points >= -0.5) & (points <= [w - 0.5, h - 0.5]), axis=1)
        return seen

    def set_potentials(self, potentials: list[list[Potential]]) -> None:
        """Hands the potentials of one scale to the kernels, one for each tube and view."""
        sizes = [p.magnitude.size for row in potentials for p in row]
        if sum(sizes) > len(self.model.samples):  # a moving scene's may grow
            self.model.samples = wp.zeros(2 * sum(sizes), dtype=wp.vec4, device=self.device)
        samples = np.zeros((len(self.model.samples), 4), np.float32)
        starts = iter(np.append(0, np.cumsum(sizes)).tolist())
        fields = []
        for k, row in enumerate(potentials):
            for v, p in enumerate(row):
                h, w = p.magnitude.shape
                start = next(starts)
                hidden = self.hidden[k][v]
                shown = p.samples if hidden is None else hidden.seen_of(p, self.maps[k][v])
                if len(self.meetings[k][v]):
                    shown = shown * clear_of(self.meetings[k][v], p, self.maps[k][v])
                samples[start : start + h * w] = shown.reshape(-1, 4)
                f = image_kernels.Field()
                f.start, f.width, f.height = start, w, h
                f.x0, f.y0, f.step, f.sigma = *p.origin, p.step, p.sigma
                height, width = self.views[v].image.shape[:2]
                f.first, f.last = wp.vec2(0.0, 0.0), wp.vec2(float(width - 1), float(height - 1))
                # contour length counts in lengths of the tube's own spine
                f.gain = self.settings.gain * LINE_LOAD * self.unit / self.lengths[k]
                if self.settings.force == "paper":
                    # the chain rule of (11) yields px a length where a displacement is a length a px
                    f.gain *= (self._pixel(k, v) / self.unit) ** 2 / len(row)
                else:
                    f.gain *= self.share[k, v]
                fields.append(f)
        self.model.samples.assign(samples)
        host = wp.array(fields, dtype=image_kernels.Field, device="cpu").numpy()
        self.model.fields.assign(host.reshape(len(potentials), len(self.views)))
        self._spread()
