"""Alternating directions (section 5): (1 + dt Kx)(1 + dt Ks) D = dt R, factored pentadiagonal lines."""

from __future__ import annotations

import functools
from collections.abc import Collection

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import SPINE_TO_RING, SYMMETRY, Model, State
from .base import ALONG, AROUND, SPINE, Solver, end_mass, slow_mean, touches
from .bounds import along
from .factor import cyclic_bands, factor_cyclic, factor_open, open_bands

HELD = 1e6
"""Diagonal of a node that must not move: a closed end in all modes but its mean."""


class SolverADI(Solver):
    """The paper's operator splitting: P = (1 + dt Kx)(M + dt Ks) = M + dt (M Kx + Ks) + dt^2 Kx Ks.

    Bears any step of elastic forces; twist w11, which is not in P, any if w11^2 <= w20 w02, and else as `bounds` finds.

    With mass, P has the weights' maxima along s in Kx and round the rings in Ks, so that the two commute: a step keeps
    H + h^2 / 8 u' (K^ - K) u + h^4 / (32 mu + 16 gamma h) u' Kx Ks u, the H of `Solver` and what those maxima, K^, and the
    splitting add to the inertia of stiff modes. That is no less than H, so no step of elastic forces is too long.
    """

    name, title, remedy = "adi", "alternating directions", ' or use solver.scheme = "direct"'
    bears_mass = True
    means_apart = True

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        n, r = model.nodes, model.rings
        device = model.device

        def zeros(shape: int, dtype: type) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        self.x_factor = {"factor": zeros(n, wp.vec3), "border": zeros(n, wp.vec2), "corner": zeros(r, wp.vec3)}
        self.s_factor, self.low_factor = zeros(n, wp.vec3), zeros(4 * r, wp.vec3)
        self._low = np.zeros((4, r, 3))
        self.node_weight = wp.zeros(n, dtype=float, device=device)
        super().__init__(model, dt, slow, momentum)

    @property
    def share(self) -> float:
        return 1.0 if self.mass else 0.5

    @property
    def form(self) -> tuple:
        return *super().form, self.uneven

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        changed = self._prepare(changed)
        self.uneven = bool(np.any(self.weight != 1))
        self.node_weight.assign(self.weight.astype(np.float32))
        for k in range(self.model.tubes if self.mass else 0):
            if np.ptp(self.weight[self.model.nodes_of(k)]) > 0:
                raise ValueError('material.mu and gamma vary over a tube: use solver.scheme = "direct"')
        host, coupling = self.model.stiffness(self.share), self.model.coupling.numpy().astype(float)
        if touches(changed, AROUND | {"b"}):
            self._factor_rings(host, coupling)
        if touches(changed, ALONG):
            self._factor_meridians(host)
        low = touches(changed, ALONG | {"reaction", "b", "depth", "guide"})
        if low:
            self._factor_slow(host)
        spine = touches(changed, SPINE | {"a"})
        if spine:
            self._factor_spine(host, coupling)
        if low or spine:
            self.low_factor.assign(self._low.reshape(-1, 3).astype(np.float32))

    def _grid(self, host: dict[str, np.ndarray], name: str, k: int) -> np.ndarray:
        """A weight of tube k, shape (ns, nx); with mass, what is implicit around is even along, and the other way."""
        nx, ns = self.model.grids[k]
        own = host[name][self.model.nodes_of(k)].reshape(ns, nx)
        if self.mass:
            own = np.broadcast_to(own.max(axis=0 if name in ("w10", "w20") else 1, keepdims=True), (ns, nx))
        return own

    def _factor_rings(self, host: dict[str, np.ndarray], coupling: np.ndarray) -> None:
        m = self.model
        x = {"factor": np.zeros((m.nodes, 3)), "border": np.zeros((m.nodes, 2)), "corner": np.zeros((m.rings, 3))}
        for k, (nx, ns) in enumerate(m.grids):
            nodes, rings, dt = m.nodes_of(k), m.rings_of(k), float(self.steps[k, 0])
            b = coupling[rings, SYMMETRY][:, None]
            if self.mass:
                b = np.broadcast_to(b.max(), b.shape)
            # symmetry (8) acts on what a ring has beyond its slow modes, so it is taken implicitly too
            diagonal, first, second = cyclic_bands(self._grid(host, "w10", k), self._grid(host, "w20", k), 1 / nx)
            weight = self.weight[nodes].reshape(ns, nx)
            factors = factor_cyclic(weight + dt * (diagonal + b), dt * first, dt * second)
            x["factor"][nodes], x["border"][nodes] = factors["factor"].reshape(-1, 3), factors["border"].reshape(-1, 2)
            x["corner"][rings] = factors["corner"]
        for key, array in self.x_factor.items():
            array.assign(x[key].astype(np.float32))

    def _factor_meridians(self, host: dict[str, np.ndarray]) -> None:
        s = np.zeros((self.model.nodes, 3))
        for k in range(self.model.tubes):
            tension, rigidity = self._grid(host, "w01", k).T, self._grid(host, "w02", k).T
            nodes, (nx, ns) = self.model.nodes_of(k), self.model.grids[k]
            inertia = self.weight[nodes].reshape(ns, nx).T
            factors = self._along(tension, rigidity, float(self.steps[k, 0]), self._closed(k), inertia=inertia)
            s[nodes] = factors.transpose(1, 0, 2).reshape(-1, 3)
        self.s_factor.assign(s.astype(np.float32))

    def _factor_slow(self, host: dict[str, np.ndarray]) -> None:
        tie = self.tie()
        for k in range(self.model.tubes):
            rings = self.model.rings_of(k)
            tension, rigidity = (slow_mean(self._grid(host, name, k))[None] for name in ("w01", "w02"))
            dt, mean = float(self.steps[k, 1]), self.low_weight[0, rings]
            self._low[0, rings] = self._along(tension, rigidity, dt, False, tie[rings], mean)[0]
            self._low[1:3, rings] = self._along(tension, rigidity, dt, self._closed(k), inertia=mean)[0]

    def _factor_spine(self, host: dict[str, np.ndarray], coupling: np.ndarray) -> None:
        for k in range(self.model.tubes):
            rings = self.model.rings_of(k)
            a, dt, own = coupling[rings, SPINE_TO_RING], float(self.steps[k, 2]), self.low_weight[3, rings]
            spine = self._along(host["w1"][rings][None], host["w2"][rings][None], dt, False, a, own)
            self._low[3, rings] = spine[0]

    def _closed(self, k: int) -> bool:
        return bool(self.model.host_ring_closed[self.model.rings_of(k)][0])

    def margins(self, k: int, dt: float) -> np.ndarray:
        q, facts = super().margins(k, dt), self.facts[k]
        share = 0.0 if self.mass else 1.0  # of K that a step of first order has to spare
        fast = slice(0 if self.mass else 2, None)
        q[fast] += share * (facts.ring + facts.b)[fast]
        if self.mass:
            q[0] += facts.tie[0] if facts.closed else facts.b
        m, nodes = self.model, self.model.nodes_of(k)
        w01, w02, w11 = (self.spare[name][nodes] for name in ("w01", "w02", "w11"))
        w11 = float(w11.max())
        if w11 == 0:
            return q
        mu, gamma = (a.numpy()[nodes] for a in (m.mu, m.gamma))
        ks, stretch = self._modes(float(w01.min()), float(w02.min()), m.grids[k][1])
        # what the splitting adds: 2 dt Kx Ks, with mass Kx Ks / (4 mu / h^2 + 2 gamma / h)
        split = np.full(len(q), 1 / (4 * mu.max() / dt**2 + 2 * gamma.max() / dt) if self.mass else 2 * dt / gamma.max())
        split[: fast.start] *= self.slow
        left = q[:, None] + share * ks + split[:, None] * facts.ring[:, None] * ks - 2 * w11 * facts.lap[:, None] * stretch
        return left.min(axis=1)

    def bears_coupling(self, k: int, dt: float) -> bool:
        return self.bears_place(k, dt, tied=not self.mass or self.facts[k].closed)

    @staticmethod
    @functools.lru_cache(64)
    def _modes(tension: float, rigidity: float, ns: int) -> tuple[np.ndarray, np.ndarray]:
        return along(tension, rigidity, ns)

    @staticmethod
    def _along(
        tension: np.ndarray,
        rigidity: np.ndarray,
        dt: float,
        held: bool,
        extra: np.ndarray | float = 0.0,
        inertia: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """Factors of mass (inertia + dt extra) + dt Ks for lines along s, shape (lines, ns, 3)."""
        ns = tension.shape[1]
        diagonal, first, second = open_bands(tension, rigidity, 1 / (ns - 1))
        mass = end_mass(ns)
        diagonal = mass * (inertia + dt * extra) + dt * diagonal
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
        if self.uneven:  # between the sweeps stands the inertia: (W + dt Kx) W^-1 (M W + dt Ks)
            wp.launch(integrate.scale_nodes, m.nodes, inputs=[self.node_weight], outputs=[s.delta], device=m.device)
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
