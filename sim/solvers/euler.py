"""Explicit Euler: T += dt R. A parallel scheme of local operations; stiff tubes need tiny steps (section 5)."""

from __future__ import annotations

import numpy as np

from .bounds import STRETCH
from .jacobi import SolverJacobi


class SolverEuler(SolverJacobi):
    """Bears steps up to 2 over the largest stiffness, of which the sum of a row is a bound.

    With mass it is leapfrog, up to 2 sqrt(mu / stiffness). Takes `base.SAFE` of that by default; a longer one is an error.
    """

    name, title = "euler", "explicit Euler"
    default_dt = np.inf
    default_slow = 1.0
    spine = 1.0
    bears_mass = True

    def longest_step(self) -> float:
        m, (node, low) = self.model, self.stiffness()
        slow = 1.0 if self.mass else self.slow
        low[:3] *= slow
        low[3] *= slow * self.spine
        least = np.inf
        for k, (nx, _) in enumerate(m.grids):
            nodes, rings = m.nodes_of(k), m.rings_of(k)
            explicit = STRETCH * m.image_load[k] * nx + self.facts[k].upright
            stiffest = max(float(node[nodes].max()), float(low[:, rings].max())) + explicit
            if self.mass:
                mu = min(float(a.numpy().min()) for a in (m.mu, m.spine_mu))
                least = min(least, 2 * np.sqrt(mu / stiffest))
            else:
                gamma = min(float(m.gamma.numpy()[nodes].min()), float(m.spine_gamma.numpy()[rings].min()))
                least = min(least, 2 * gamma / max(stiffest, 1.0))
        return least

    def bears(self, dt: float) -> bool:
        return dt <= self.longest_step()

    def diagonals(self) -> tuple[np.ndarray, np.ndarray]:
        """As for Jacobi, without any stiffness."""
        mass, low_mass = self.masses()
        return 1 / (mass * self.weight), 1 / (low_mass * self.low_weight)
