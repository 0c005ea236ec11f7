"""Models of tubes given by hand, launches by argument names, and probes of the kernels' functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from symseek.kernels import contour, image
from symseek.sim import model as layout
from symseek.sim.camera import Camera
from symseek.sim.force import add_forces
from symseek.sim.model import Model, State

EPS = 2.0**-23
"""Spacing of float32 at 1."""
COLUMNS = {
    "a": layout.SPINE_TO_RING, "reaction": layout.REACTION, "b": layout.SYMMETRY, "c": layout.EXPAND,
    "balance": layout.BALANCE, "d": layout.UPRIGHT, "centre": layout.CENTRE, "depth": layout.DEPTH, "free": layout.FREE,
}  # fmt: skip


class Rig:
    """Tubes (ns, nx, 3), ring after ring, with spines (ns, 3); every weight is 0 unless given.

    Weights are numbers or arrays over all nodes (of w10, w20, w11, w01, w02), rings or tubes. A picture is
    (samples (h, w, 4), image point of the first, image pixels a sample).
    """

    def __init__(self, *pairs, closed=False, camera=None, picture=None, **weights):
        samples, origin, step = picture or (np.zeros((2, 2, 4)), (0.0, 0.0), 1.0)
        h, w = samples.shape[:2]
        grids = [(tube.shape[1], tube.shape[0]) for tube, _ in pairs]
        self.model = m = Model(grids, [closed] * len(pairs), 1, h * w, "cpu")
        m.set_cameras([camera or Camera.orthographic()])
        m.samples.assign(samples.reshape(-1, 4).astype(np.float32))
        field = image.Field()
        field.first, field.last = wp.vec2(-1e6), wp.vec2(1e6)
        field.width, field.height, field.step, field.gain = w, h, step, 1.0
        field.x0, field.y0 = map(float, origin)
        fields = wp.array([field] * len(pairs), dtype=image.Field, device="cpu").numpy()
        m.fields.assign(fields.reshape(-1, 1))
        coupling = np.zeros((m.rings, len(COLUMNS)), np.float32)
        for name, value in weights.items():
            if name in COLUMNS:
                coupling[:, COLUMNS[name]] = value
            else:
                array = getattr(m, name)
                array.assign(np.broadcast_to(np.asarray(value, np.float32), array.numpy().shape))
        m.coupling.assign(coupling)
        self.state = s = State(m)
        s.tube.assign(np.concatenate([np.reshape(tube, (-1, 3)) for tube, _ in pairs]).astype(np.float32))
        s.spine.assign(np.concatenate([spine for _, spine in pairs]).astype(np.float32))

    def forces(self, contour="subnode", literal=False, tau=0.05) -> tuple[np.ndarray, np.ndarray]:
        """Forces on the first tube (ns, nx, 3) and on all spine nodes (R, 3), float64; whatever is left unset is NaN."""
        for name, array in vars(self.state).items():
            if name not in ("tube", "spine", "velocity", "spine_velocity", "age"):
                array.fill_(np.nan)
        add_forces(self.model, self.state, contour, literal, tau)
        nx, ns = self.model.grids[0]
        tube = self.state.force.numpy()[: nx * ns].reshape(ns, nx, 3)
        return tube.astype(float), self.state.spine_force.numpy().astype(float)

    def launch(self, kernel: Any, size: int, **arguments: Any) -> None:
        """Launches a kernel by names of arguments: those given, else the model's, else (`_in`, `_out`) the state's."""
        names = [a.label for a in kernel.adj.args]
        for name in names:
            if name not in arguments:
                owner = self.model if hasattr(self.model, name) else self.state
                arguments[name] = getattr(owner, name.removesuffix("_in").removesuffix("_out"))
        wp.launch(kernel, size, inputs=[arguments[name] for name in names], device="cpu")

    def tube(self) -> np.ndarray:
        """Nodes of the first tube as the kernels see them, (ns, nx, 3), float64."""
        nx, ns = self.model.grids[0]
        return self.state.tube.numpy()[: nx * ns].reshape(ns, nx, 3).astype(float)

    def spine(self) -> np.ndarray:
        """Spine nodes as the kernels see them, (R, 3), float64."""
        return self.state.spine.numpy().astype(float)


def array(values: np.ndarray, dtype: type = float) -> wp.array:
    """A Warp array of what numpy holds."""
    kind = np.int32 if dtype is int else np.float32
    return wp.array(np.ascontiguousarray(values, kind), dtype=dtype, device="cpu")


def even_spine(ns: int, length: float = 1.0) -> np.ndarray:
    """A straight spine along Y, (ns, 3)."""
    return np.linspace(0, length, ns)[:, None] * np.array([0.0, 1.0, 0.0])


def circles(spine: np.ndarray, radius: ArrayLike, nx: int, turn: float = 0.0) -> np.ndarray:
    """Circles across Y round a spine, outward normals by dx cross ds, (ns, nx, 3)."""
    angle = 2 * np.pi * np.arange(nx) / nx + turn
    ring = np.stack([np.cos(angle), np.zeros(nx), -np.sin(angle)], -1)
    return spine[:, None] + np.broadcast_to(radius, len(spine))[:, None, None] * ring


@wp.kernel(enable_backward=False)
def ring_crossings(
    tube: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    facing: wp.array[float],
    n: int,
    position_out: wp.array[wp.vec3],
):
    """Sets the contour's crossing on each node's edge to the next node of its ring; any point where there is none."""
    i = wp.tid()
    position_out[i] = contour.along_edge(tube, normal, facing, i - i % n, i % n, n, 0, 0, 0, 0).position  # pyright: ignore


@wp.kernel(enable_backward=False)
def meridian_crossings(
    tube: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    facing: wp.array[float],
    n: int,
    ns: int,
    position_out: wp.array[wp.vec3],
):
    """Sets the contour's crossing on each node's edge to the next ring; any point where there is none."""
    i = wp.tid()
    position_out[i] = contour.along_edge(tube, normal, facing, i - i % n, i % n, n, i // n, 0, ns - 1, 3).position  # pyright: ignore
