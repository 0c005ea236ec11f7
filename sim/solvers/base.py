"""What every scheme shares: steps of each tube, slow modes apart, the update."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import DEPTH, REACTION, SYMMETRY, UPRIGHT, Model, State

AROUND = frozenset({"w10", "w20", "bound10"})
ALONG = frozenset({"w01", "w02", "bound01"})
SPINE = frozenset({"w1", "w2", "k1", "bound1"})
"""Arrays of the model that make the stiffness of rings, of meridians and of the spine."""


def touches(changed: Collection[str] | None, names: frozenset[str]) -> bool:
    """Whether any of `names` is among what changed; None: everything did."""
    return changed is None or not names.isdisjoint(changed)


class Solver:
    """First-order integration of (10), mu = 0 and gamma = 1: T += P^-1 R with a scheme's own P.

    Equilibrium is R = 0 whatever P. The modes k = 0, +-1 of each ring (place, radius, tilt), which the
    image reaches through two nodes only, take a step `slow` times as long.
    """

    default_dt = 0.4
    default_slow = 12.0
    spine = 5.0
    """Step of the spine over that of the slow modes."""

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        self.model, self.momentum = model, momentum
        self.step_size = wp.zeros((model.tubes, 3), dtype=float, device=model.device)
        self.set_step(dt or self.default_dt, slow or self.default_slow)
        self.first_mode = wp.zeros(model.rings, dtype=float, device=model.device)
        self.material_changed()

    def set_step(self, dt: float, slow: float) -> None:
        """Time steps of nodes, of slow modes and of the spine, which has next to no inertia: it follows its rings."""
        self.dt, self.slow_dt, self.spine_dt = dt, dt * slow, self.spine * dt * slow
        steps = np.array([self.dt, self.slow_dt, self.spine_dt], np.float32)
        self.step_size.assign(np.tile(steps, (self.model.tubes, 1)))

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        """Makes the factors again; to be called after weights of the model changed.

        Args:
            changed: names as `Weights.write` returns them; None: all. What does not depend on them is kept.
        """
        if not touches(changed, AROUND | {"b", "d"}):
            return
        stiffness = np.zeros(self.model.rings)
        host = self.model.stiffness(0.5)
        for k, (nx, ns) in enumerate(self.model.grids):
            lap = (2 * np.sin(np.pi / nx) * nx) ** 2
            for w, factor in ((host["w10"], lap), (host["w20"], lap**2)):
                stiffness[self.model.rings_of(k)] += factor * slow_mean(w[self.model.nodes_of(k)].reshape(ns, nx))
        coupling = self.model.coupling.numpy()
        stiffness += 0.5 * coupling[:, SYMMETRY] + coupling[:, UPRIGHT]
        self.first_mode.assign(stiffness.astype(np.float32))

    def tie(self) -> np.ndarray:
        """Stiffness of the ties of a ring's mean to the spine and to its depth, (7) and (8), shape (R,)."""
        coupling = self.model.coupling.numpy().astype(float)
        return coupling[:, REACTION] + 0.5 * coupling[:, SYMMETRY] + coupling[:, DEPTH]

    def solve_lines(self, state: State) -> None:
        """Turns dt R in `state.delta` and `state.low` into the step, in place."""
        raise NotImplementedError

    def step(self, state: State) -> None:
        """One step from the forces in `state`: launches only, so it can be captured."""
        m, s = self.model, state
        wp.launch(
            integrate.split_modes,
            m.rings,
            inputs=[
                m.ring_tube, m.ring_node, m.tube_nx, m.ring_closed, m.node_wave, self.first_mode, self.step_size,
                s.tube, s.centroid, s.force, s.spine_force, s.velocity, m.rings,
            ],
            outputs=[s.delta, s.low, s.residual, s.power],
            device=m.device,
        )  # fmt: skip
        self.solve_lines(state)
        wp.launch(
            integrate.gather_momentum,
            m.tubes,
            inputs=[m.tube_ring, m.tube_ns, s.power, self.momentum],
            outputs=[s.age, s.momentum],
            device=m.device,
        )
        wp.launch(
            integrate.advance,
            m.nodes,
            inputs=[m.node_ring, m.ring_tube, m.ring_node, m.node_wave, s.delta, s.low, s.momentum, m.rings],
            outputs=[s.tube, s.spine, s.velocity, s.spine_velocity],
            device=m.device,
        )


def end_mass(ns: int) -> np.ndarray:
    """Share of a cell that belongs to each ring, shape (ns,): half at the ends."""
    m = np.ones(ns)
    m[0] = m[-1] = 0.5
    return m


def slow_mean(weight: np.ndarray) -> np.ndarray:
    """What a ring's modes k = 0, +-1 meet of an uneven weight, shape (ns, nx): its mean, and at most twice that."""
    mean = weight[:, 0] + (weight - weight[:, :1]).mean(axis=1)
    return np.minimum(weight.max(axis=1), 2 * mean)
