"""Alternating directions (section 5): (1 + dt Kx)(1 + dt Ks) D = dt R, factored pentadiagonal lines."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import SPINE_TO_RING, SYMMETRY, Model, State
from .base import ALONG, AROUND, SPINE, Solver, end_mass, slow_mean, touches
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
        self._low = np.zeros((4, r, 3))
        super().__init__(model, dt, slow, momentum)

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        super().material_changed(changed)
        host, coupling = self.model.stiffness(0.5), self.model.coupling.numpy().astype(float)
        if touches(changed, AROUND | {"b"}):
            self._factor_rings(host, coupling)
        if touches(changed, ALONG):
            self._factor_meridians(host)
        low = touches(changed, ALONG | {"reaction", "b", "depth"})
        if low:
            self._factor_slow(host)
        spine = touches(changed, SPINE | {"a"})
        if spine:
            self._factor_spine(host, coupling)
        if low or spine:
            self.low_factor.assign(self._low.reshape(-1, 3).astype(np.float32))

    def _grid(self, host: dict[str, np.ndarray], name: str, k: int) -> np.ndarray:
        """A weight of tube k, shape (ns, nx)."""
        nx, ns = self.model.grids[k]
        return host[name][self.model.nodes_of(k)].reshape(ns, nx)

    def _factor_rings(self, host: dict[str, np.ndarray], coupling: np.ndarray) -> None:
        m = self.model
        x = {"factor": np.zeros((m.nodes, 3)), "border": np.zeros((m.nodes, 2)), "corner": np.zeros((m.rings, 3))}
        for k, (nx, _) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            # symmetry (8) acts on what a ring has beyond its slow modes, so it is taken implicitly too
            diagonal, first, second = cyclic_bands(self._grid(host, "w10", k), self._grid(host, "w20", k), 1 / nx)
            b = coupling[rings, SYMMETRY][:, None]
            factors = factor_cyclic(1 + self.dt * (diagonal + b), self.dt * first, self.dt * second)
            x["factor"][nodes], x["border"][nodes] = factors["factor"].reshape(-1, 3), factors["border"].reshape(-1, 2)
            x["corner"][rings] = factors["corner"]
        for key, array in self.x_factor.items():
            array.assign(x[key].astype(np.float32))

    def _factor_meridians(self, host: dict[str, np.ndarray]) -> None:
        s = np.zeros((self.model.nodes, 3))
        for k in range(self.model.tubes):
            tension, rigidity = self._grid(host, "w01", k).T, self._grid(host, "w02", k).T
            factors = self._along(tension, rigidity, self.dt, self._closed(k))
            s[self.model.nodes_of(k)] = factors.transpose(1, 0, 2).reshape(-1, 3)
        self.s_factor.assign(s.astype(np.float32))

    def _factor_slow(self, host: dict[str, np.ndarray]) -> None:
        tie = self.tie()
        for k in range(self.model.tubes):
            rings = self.model.rings_of(k)
            tension, rigidity = (slow_mean(self._grid(host, name, k))[None] for name in ("w01", "w02"))
            self._low[0, rings] = self._along(tension, rigidity, self.slow_dt, False, extra=tie[rings])[0]
            self._low[1:3, rings] = self._along(tension, rigidity, self.slow_dt, self._closed(k))[0]

    def _factor_spine(self, host: dict[str, np.ndarray], coupling: np.ndarray) -> None:
        for k in range(self.model.tubes):
            rings = self.model.rings_of(k)
            a = coupling[rings, SPINE_TO_RING]
            spine = self._along(host["w1"][rings][None], host["w2"][rings][None], self.spine_dt, False, extra=a)
            self._low[3, rings] = spine[0]

    def _closed(self, k: int) -> bool:
        return bool(self.model.host_ring_closed[self.model.rings_of(k)][0])

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
