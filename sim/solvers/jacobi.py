"""Implicit Euler by Jacobi: one sweep a step over the diagonal of mass + dt K."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import SPINE_TO_RING, SYMMETRY, Model, State
from .base import MATRIX, Solver, end_mass, touches
from .factor import cyclic_bands, open_bands


class SolverJacobi(Solver):
    """Bears any step of the elastic forces, since each node is divided by its own stiffness; slow for stiff tubes.

    P is diagonal and at least M + dt K / 2, so that 2 P / dt - K leaves 2 / dt for explicit forces.
    """

    name, title, remedy = "jacobi", "implicit Jacobi", ' or use solver.scheme = "adi"'

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        self.inverse = wp.zeros(model.nodes, dtype=float, device=model.device)
        self.low_inverse = wp.zeros(4 * model.rings, dtype=float, device=model.device)
        super().__init__(model, dt, slow, momentum)

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        if not touches(self._prepare(changed), MATRIX):
            return
        inverse, low = self.diagonals()
        self.inverse.assign(inverse.astype(np.float32))
        self.low_inverse.assign(low.reshape(-1).astype(np.float32))

    def bears_coupling(self, k: int, dt: float) -> bool:
        return self.bears_place(k, dt, share=0.5)

    def stiffness(self) -> tuple[np.ndarray, np.ndarray]:
        """Bound of each node's and each slow line's stiffness: twice its diagonal, the sum of a row of |K|."""
        m = self.model
        coupling = m.coupling.numpy().astype(float)
        host = m.stiffness(self.share)
        node, low = np.zeros(m.nodes), np.zeros((4, m.rings))
        for k, (nx, ns) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            grid = {key: host[key][nodes].reshape(ns, nx) for key in ("w10", "w20", "w01", "w02")}
            around = row_sum(cyclic_bands(grid["w10"], grid["w20"], 1 / nx), cyclic=True)
            along = row_sum(open_bands(grid["w01"].T, grid["w02"].T, 1 / (ns - 1)), cyclic=False).T
            along = along / end_mass(ns)[:, None]
            # a row of |twist| sums to four cells of four entries each, at an end to half of that on half the mass
            twist = 2 * host["w11"][nodes].max() * (nx * (ns - 1)) ** 2 * 16
            node[nodes] = (around + along + twist + coupling[rings, SYMMETRY][:, None]).reshape(-1)
            low[:3, rings] = along.max(axis=1)
            low[0, rings] += 2 * self.tie()[rings]
            low[1:3, rings] += twist * (2 * np.sin(np.pi / nx)) ** 2 / 4
            spine = row_sum(
                open_bands(host["w1"][rings][None], host["w2"][rings][None], 1 / (ns - 1)),
                cyclic=False,
            )[0]
            low[3, rings] = spine / end_mass(ns) + 2 * coupling[rings, SPINE_TO_RING]
        return node, low

    def masses(self) -> tuple[np.ndarray, np.ndarray]:
        """Share of a cell of each node and of each entry of a slow line."""
        m = self.model
        ring = np.concatenate([end_mass(ns) for _, ns in m.grids])
        return ring[m.node_ring.numpy().astype(int)], np.tile(ring, (4, 1))

    def diagonals(self) -> tuple[np.ndarray, np.ndarray]:
        """What each entry of dt R is multiplied by, for nodes and slow lines."""
        node, low = self.stiffness()
        m = self.model
        mass, low_mass = self.masses()
        # half the sum of a row of |K| keeps Jacobi's sweep stable for fourth differences, where the diagonal alone is not
        by_ring = self.steps[m.host_ring_tube]
        dt, low_dt = by_ring[m.node_ring.numpy().astype(int), 0], by_ring[:, [1, 1, 1, 2]].T
        return 1 / (mass * (self.weight + 0.5 * dt * node)), 1 / (low_mass * (self.low_weight + 0.5 * low_dt * low))

    def solve_lines(self, state: State) -> None:
        for inverse, target in ((self.inverse, state.delta), (self.low_inverse, state.low)):
            wp.launch(
                integrate.scale_nodes,
                len(target),
                inputs=[inverse],
                outputs=[target],
                device=self.model.device,
            )


def row_sum(bands: tuple[np.ndarray, np.ndarray, np.ndarray], cyclic: bool) -> np.ndarray:
    """Sum of |entries| of each row of a symmetric pentadiagonal matrix given by its bands, shape (m, n)."""
    diagonal, first, second = (np.abs(b) for b in bands)
    total = diagonal + first + second
    if cyclic:
        return total + np.roll(first, 1, axis=1) + np.roll(second, 2, axis=1)
    total[:, 1:] += first[:, :-1]
    total[:, 2:] += second[:, :-2]
    return total
