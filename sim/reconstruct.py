"""Still scenes: from rough axes to tubes at rest (sections 4.1 and 5)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ..kernels import contour as contour_kernels
from ..kernels import coupling as coupling_kernels
from ..kernels import elastic as elastic_kernels
from ..kernels import image as image_kernels
from ..kernels import integrate as integrate_kernels
from .camera import Camera
from .force import add_forces
from .foreground import Foreground, axis_curve, foreground, length_of
from .initial import initial_tube, lift
from .measure import contour_support, shape_measures
from .model import Model, State
from .potential import Potential, PotentialPicture, ScaleSpace, sigma_list
from .problem import Settings, Tube, View
from .solvers import make_solver
from .surface import occluding_contour, refine

LINE_LOAD = 0.04
"""Stiffness of the contour: force a displacement for each unit of contour length and of s."""
CHECK = 10
"""Iterations between two looks at the residual."""
COARSE = 10.0
"""How much more residual a coarse scale may keep: the next scale moves the tube further than that anyway."""


@dataclass
class ObjectResult:
    """One reconstructed object, in world units."""

    name: str
    tube: np.ndarray
    """shape (1, N_x, N_s, 3)."""
    spine: np.ndarray
    """shape (1, N_s, 3)."""
    velocity: np.ndarray
    """shape (1, N_x, N_s, 3); 0 for a still scene."""
    vertices: np.ndarray
    """of the smooth watertight surface, shape (V, 3)."""
    faces: np.ndarray
    """shape (F, 3), outward."""
    contour: list[np.ndarray]
    """pieces of the occluding contour in the first view, shape (n, 2) each, image px."""
    support: list[np.ndarray]
    """for each piece, which points image data supports, shape (n,), bool."""
    measures: dict[str, object]
    history: list[tuple[np.ndarray, np.ndarray, float]]
    """tube (N_x, N_s, 3), spine (N_s, 3), sigma [px], from the first tube to the last."""
    iterations: int = 0
    converged: bool = True
    trusted: bool = True
    warnings: list[str] = field(default_factory=list)


@dataclass
class Result:
    """What a run yields."""

    objects: list[ObjectResult]
    potentials: list[PotentialPicture]
    foreground: np.ndarray | None
    """shape (H, W), first object's map in the first view's image, in [0, 1]."""
    seconds: dict[str, float]
    settings: Settings


class Progress:
    """Where a run is; handed to the callback each iteration."""

    def __init__(self, run: _Run):
        self._run = run
        self.iteration, self.total = 0, run.settings.iterations
        self.stage, self.sigma, self.residual = 0, 0.0, float("inf")

    def tube(self, k: int = 0) -> np.ndarray:
        """Nodes of tube k now, shape (N_x, N_s, 3), world units."""
        return self._run.world(k)[0]

    def spine(self, k: int = 0) -> np.ndarray:
        """Spine of tube k now, shape (N_s, 3), world units."""
        return self._run.world(k)[1]


class _Run:
    """Everything between problem and result."""

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
        self.unit = length_of(axis_curve(self.axes[0]))
        self.origin = axis_curve(self.axes[0]).mean(axis=0)
        sizes = [int(np.prod(s.shape)) for s in self.spaces]
        self.sample_start = np.concatenate([[0], np.cumsum(sizes)])
        self.model = Model([t.grid for t in tubes], [t.material.closed for t in tubes], len(views), sum(sizes), device)
        self.model.set_cameras([self._own_camera(v.camera) for v in views])
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
        camera = self.views[0].camera
        for k, tube in enumerate(self.tubes):
            axis = (self._carried_on(k) - self.origin) / self.unit
            middle = self.axes[k].mean(axis=0)
            pixel = np.linalg.norm(camera.project(middle + 1e-3 * self.unit * np.eye(3)) - camera.project(middle), axis=1)
            radius = tube.radius or 0.5 * self.maps[k].half_width * 1e-3 * self.unit / pixel.max()
            nodes, spine = initial_tube(axis, radius / self.unit, tube.grid, tube.material.closed)
            tube_flat[self.model.nodes_of(k)] = nodes.transpose(1, 0, 2).reshape(-1, 3)
            spine_flat[self.model.rings_of(k)] = spine
        self.state.tube.assign(tube_flat.astype(np.float32))
        self.state.spine.assign(spine_flat.astype(np.float32))

    def _carried_on(self, k: int) -> np.ndarray:
        """The rough axis in the world, as far as the map's object reaches; straight beyond its own ends."""
        if self.settings.potential != "map":
            return self.axes[k]
        camera = self.views[0].camera
        axis, flat = axis_curve(self.axes[k]), self.maps[k].axis
        seen = camera.project(axis)
        lead = int(((flat - seen[0]) ** 2).sum(1).argmin())
        tail = int(((flat - seen[-1]) ** 2).sum(1).argmin())
        ends = []
        for end, inner, points in ((0, 10, flat[:lead][::-1]), (-1, -11, flat[tail + 1 :])):
            reach = np.linalg.norm(points - seen[end], axis=1) / np.linalg.norm(seen[end] - seen[inner])
            ends.append(axis[end] + reach[:, None] * (axis[end] - axis[inner]))
        return np.concatenate([ends[0][::-1], axis, ends[1]])

    def world(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Tube (N_x, N_s, 3) and spine (N_s, 3) of object k in world units."""
        nx, ns = self.tubes[k].grid
        tube = self.state.tube.numpy()[self.model.nodes_of(k)].reshape(ns, nx, 3).transpose(1, 0, 2)
        spine = self.state.spine.numpy()[self.model.rings_of(k)]
        return tube * float(self.unit) + self.origin, spine * float(self.unit) + self.origin

    def set_material(self, share: float) -> None:
        """Writes the weights; `share` of the rigidities that falls with sigma (continuation)."""
        m = self.model
        node = {n: np.zeros(m.nodes, np.float32) for n in ("w10", "w20", "w11", "w01", "w02")}
        ring = {n: np.zeros(m.rings, np.float32) for n in ("w1", "w2")}
        coupling = np.zeros((m.rings, 8), np.float32)
        for k, tube in enumerate(self.tubes):
            mat, nodes, rings = tube.material, m.nodes_of(k), m.rings_of(k)
            for n in ("w10", "w20", "w11", "w01"):
                node[n][nodes] = getattr(mat, n)
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

    def set_potentials(self, potentials: list[Potential]) -> None:
        samples = np.zeros((len(self.model.samples), 4), np.float32)
        fields = []
        for k, p in enumerate(potentials):
            h, w = p.magnitude.shape
            start = int(self.sample_start[k])
            samples[start : start + h * w] = p.samples.reshape(-1, 4)
            f = image_kernels.Field()
            f.start, f.width, f.height = start, w, h
            f.x0, f.y0, f.step = *p.origin, p.step
            f.gain = self.settings.gain * LINE_LOAD
            fields.append([f])
        self.model.samples.assign(samples)
        host = wp.array([f[0] for f in fields], dtype=image_kernels.Field, device="cpu").numpy()
        self.model.fields.assign(host.reshape(len(potentials), 1))


def reconstruct(
    views: list[View],
    tubes: list[Tube],
    settings: Settings | None = None,
    device: str = "cpu",
    callback: Callable[[Progress], bool | None] | None = None,
) -> Result:
    """Reconstructs the tubes of a still scene.

    Args:
        views: the images; one for now.
        tubes: rough axes and materials.
        settings: of the solver.
        device: Warp device.
        callback: called each iteration; returning True stops the run.

    Returns:
        The objects with their measures, the potentials, seconds by phase.

    Raises:
        ValueError: the scheme cannot bear the step.
    """
    settings = settings or Settings()
    clock, seconds = time.perf_counter(), {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[name] = seconds.get(name, 0.0) + now - clock
        clock = now

    run = _Run(views, tubes, settings, device)
    lap("map")
    lists = [sigma_list(m.half_width, s.step, settings.sigmas) for m, s in zip(run.maps, run.spaces, strict=True)]
    stages = max(len(x) for x in lists)
    run.set_material(1.0)
    solver = make_solver(settings.scheme, run.model, settings.step, settings.slow, settings.momentum)
    literal = settings.force == "paper"

    def iterate() -> None:
        add_forces(run.model, run.state, settings.contour, literal, settings.tau)
        solver.step(run.state)

    for module in (elastic_kernels, coupling_kernels, contour_kernels, integrate_kernels):
        wp.load_module(module, device=device)
    lap("kernels")
    graph = None
    progress = Progress(run)
    history: list[list] = [[] for _ in tubes]
    potentials: list[list[Potential]] = []
    stop, converged = False, True
    for stage in range(stages):
        sigmas = [x[max(0, len(x) - stages + stage)] for x in lists]
        current = [space.at(sigma) for space, sigma in zip(run.spaces, sigmas, strict=True)]
        potentials.append(current)
        run.set_potentials(current)
        lap("potential")
        run.hold_depth()
        run.set_material(max(0.01, (sigmas[0] / lists[0][0]) ** 2))
        solver.material_changed()
        run.state.velocity.zero_()
        run.state.spine_velocity.zero_()
        progress.stage, progress.sigma = stage, sigmas[0]
        if graph is None:
            with wp.ScopedCapture(device=device, force_module_load=False) as capture:
                iterate()
            graph = capture.graph
        converged = False
        budget = settings.iterations // stages
        for i in range(budget):
            if i % CHECK == 0 and (callback or i % 30 == 0):
                for k in range(len(tubes)):
                    history[k].append((*run.world(k), sigmas[k]))
            wp.capture_launch(graph)
            progress.iteration += 1
            if i % CHECK == CHECK - 1:
                progress.residual = float(np.sqrt(run.state.residual.numpy().mean()))
                converged = progress.residual < settings.tolerance * (1 if stage == stages - 1 else COARSE)
            if callback and callback(progress):
                stop = True
            if converged or stop:
                break
        lap("solve")
        if stop:
            break
    objects = []
    for k, tube in enumerate(tubes):
        history[k].append((*run.world(k), progress.sigma))
        objects.append(_finish(run, k, tube, potentials[-1][k], history[k], progress.iteration, converged))
    lap("measure")
    return Result(objects, [p[0].picture for p in potentials], _map_in_image(run), seconds, settings)


def _finish(run: _Run, k: int, tube: Tube, potential: Potential, history: list, iterations: int, converged: bool) -> ObjectResult:
    nodes, spine = run.world(k)
    vertices, faces = refine(nodes)
    measures = shape_measures(nodes, spine)
    pieces = occluding_contour(nodes, run.views[0].camera)
    space = run.spaces[k]
    inside = space.inside if run.settings.potential == "map" else np.zeros((0, 0))
    support = [contour_support(p, n, potential, inside, run.maps[k].half_width) for p, n in pieces]
    flags = np.concatenate([s.supported for s in support]) if support else np.zeros(0, bool)
    offsets = np.abs(np.concatenate([s.offset for s in support]))[flags] if support else np.zeros(0)
    measures["supported_share"] = float(flags.mean()) if len(flags) else 0.0
    measures["contour_residual_px"] = (
        {"mean": float(offsets.mean()), "p95": float(np.quantile(offsets, 0.95)), "max": float(offsets.max())}
        if len(offsets)
        else {"mean": float("nan"), "p95": float("nan"), "max": float("nan")}
    )
    return ObjectResult(
        name=tube.name,
        tube=nodes[None],
        spine=spine[None],
        velocity=np.zeros_like(nodes)[None],
        vertices=vertices,
        faces=faces,
        contour=[p for p, _ in pieces],
        support=[s.supported for s in support],
        measures=measures,
        history=history,
        iterations=iterations,
        converged=converged,
    )


def _map_in_image(run: _Run) -> np.ndarray:
    h, w = run.views[0].image.shape[:2]
    return run.maps[0].in_image((h, w))
