"""Explicit Euler: T += dt R. A parallel scheme of local operations; stiff tubes need tiny steps (section 5)."""

from __future__ import annotations

import numpy as np

from .jacobi import SolverJacobi


class SolverEuler(SolverJacobi):
    """Bears steps up to 2 over the largest stiffness; a longer one is an error."""

    def diagonals(self) -> tuple[np.ndarray, np.ndarray]:
        node, low = self.stiffness()
        largest = 2 / max(float(node.max()), 1.0)
        slow = 2 / max(float(low[:3].max()), 1.0)
        if self.dt > largest or self.slow_dt > slow or self.dt * float(low[3].max()) > 2:
            bound = min(largest, slow * self.dt / self.slow_dt, 2 / float(low[3].max()))
            raise ValueError(
                f"explicit Euler cannot bear a step of {self.dt:g} with this material and grid: at most {bound:.3g}; "
                'set solver.step lower, or solver.scheme = "adi"'
            )
        mass, low_mass = self.masses()
        return 1 / mass, 1 / low_mass
