"""Alternating directions (section 5): (1 + dt Kx)(1 + dt Ks) D = dt R, factored pentadiagonal lines."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import SPINE_TO_RING, SYMMETRY, Model, State
from .base import Solver, end_mass
from .factor import cyclic_bands, factor_cyclic, factor_open, open_bands

HELD = 1e6
"""Diagonal of a node that must not move: a closed end in all modes but its mean."""


class SolverADI(Solver):
    """The paper's operator splitting; bears any step of the elastic forces, dt <= 1 of coupling and image forces."""

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        n, r = model.nodes, model.rings
        device = model.device

        def zeros(shape: int, dtype: type) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        self.x_factor = {"factor": zeros(n, wp.vec3), "border": zeros(n, wp.vec2), "corner": zeros(r, wp.vec3)}
        self.s_factor, self.low_factor = zeros(n, wp.vec3), zeros(4 * r, wp.vec3)
        super().__init__(model, dt, slow, momentum)

    def material_changed(self) -> None:
        super().material_changed()
        m = self.model
        host = {k: getattr(m, k).numpy().astype(float) for k in ("w10", "w20", "w01", "w02", "w1", "w2")}
        coupling = m.coupling.numpy().astype(float)
        tie, k1 = self.tie(), m.k1.numpy()
        x = {"factor": np.zeros((m.nodes, 3)), "border": np.zeros((m.nodes, 2)), "corner": np.zeros((m.rings, 3))}
        s, low = np.zeros((m.nodes, 3)), np.zeros((4, m.rings, 3))
        for k, (nx, ns) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            closed = bool(m.host_ring_closed[rings][0])
            grid = {key: host[key][nodes].reshape(ns, nx) for key in ("w10", "w20", "w01", "w02")}
            # symmetry (8) acts on what a ring has beyond its slow modes, so it is taken implicitly too
            diagonal, first, second = cyclic_bands(grid["w10"], grid["w20"], 1 / nx)
            b = coupling[rings, SYMMETRY][:, None]
            factors = factor_cyclic(1 + self.dt * (diagonal + b), self.dt * first, self.dt * second)
            x["factor"][nodes], x["border"][nodes] = factors["factor"].reshape(-1, 3), factors["border"].reshape(-1, 2)
            x["corner"][rings] = factors["corner"]
            s[nodes] = self._along(grid["w01"].T, grid["w02"].T, self.dt, closed).transpose(1, 0, 2).reshape(-1, 3)
            tension, rigidity = grid["w01"].mean(1)[None], grid["w02"].mean(1)[None]
            low[0, rings] = self._along(tension, rigidity, self.slow_dt, False, extra=tie[rings])[0]
            low[1:3, rings] = self._along(tension, rigidity, self.slow_dt, closed)[0]
            a = coupling[rings, SPINE_TO_RING]
            spine = self._along(host["w1"][rings][None] + k1[k], host["w2"][rings][None], self.spine_dt, False, extra=a)
            low[3, rings] = spine[0]
        for key, array in self.x_factor.items():
            array.assign(x[key].astype(np.float32))
        self.s_factor.assign(s.astype(np.float32))
        self.low_factor.assign(low.reshape(-1, 3).astype(np.float32))

    @staticmethod
    def _along(
        tension: np.ndarray, rigidity: np.ndarray, dt: float, held: bool, extra: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Factors of mass + dt Ks for lines along s, shape (lines, ns, 3)."""
        ns = tension.shape[1]
        diagonal, first, second = open_bands(tension, rigidity, 1 / (ns - 1))
        mass = end_mass(ns)
        diagonal = mass * (1 + dt * extra) + dt * diagonal
        if held:
            diagonal[:, [0, -1]] += HELD
        return np.stack(factor_open(diagonal, dt * first, dt * second), axis=2)

    def solve_lines(self, state: State) -> None:
        m, s, x = self.model, state, self.x_factor
        wp.launch(
            integrate.sweep_rings,
            m.rings,
            inputs=[m.ring_tube, m.ring_node, m.tube_nx, m.ring_closed, x["factor"], x["border"], x["corner"]],
            outputs=[s.delta],
            device=m.device,
        )
        wp.launch(
            integrate.sweep_meridians,
            m.lines,
            inputs=[
                m.line_tube, m.line_x, m.tube_nx, m.tube_ns, m.tube_node, m.tube_ring,
                self.s_factor, self.low_factor, m.rings,
            ],
            outputs=[s.delta, s.low],
            device=m.device,
        )  # fmt: skip
