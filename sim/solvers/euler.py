"""Explicit Euler: T += dt R. A parallel scheme of local operations; stiff tubes need tiny steps (section 5)."""

from __future__ import annotations

import numpy as np

from ..model import Model
from .jacobi import SolverJacobi

SAFE = 0.9
"""Share of the largest stable step that is taken when none is asked for."""


class SolverEuler(SolverJacobi):
    """Bears steps up to 2 over the largest stiffness: takes `SAFE` of that by default; a longer one is an error."""

    default_slow = 1.0
    spine = 1.0

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        self.asked = dt
        super().__init__(model, dt, slow, momentum)

    def diagonals(self) -> tuple[np.ndarray, np.ndarray]:
        """As for Jacobi, without any stiffness.

        Raises:
            ValueError: the step is longer than the scheme bears.
        """
        node, low = self.stiffness()
        ratio = self.slow_dt / self.dt
        stiffest = max(float(node.max()), ratio * float(low[:3].max()), ratio * self.spine * float(low[3].max()), 1.0)
        if self.asked is None:
            self.set_step(SAFE * 2 / stiffest, ratio)
        elif self.dt > 2 / stiffest:
            raise ValueError(
                f"solver.step = {self.dt:g} is too long for explicit Euler with this material and grid: at most"
                f' {2 / stiffest:.3g}; lower it, leave it out, or use solver.scheme = "adi"'
            )
        mass, low_mass = self.masses()
        return 1 / mass, 1 / low_mass
