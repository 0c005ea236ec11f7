"""Implicit Euler with a sparse direct factorisation (section 5), by SciPy's SuperLU in float64 on the host."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.sparse.linalg import splu

from ..model import State
from .base import MATRIX, Solver, touches
from .matrix import step_matrix


class SolverDirect(Solver):
    """P = M + dt K of tube and spine, without splitting; with slow = 1 of all modes at once.

    Bears any step of the elastic forces, twist included. Robust, and expensive for fine grids. Each step fetches the right
    side from the device and hands the solution back, so that no graph can hold it.
    """

    name, title = "direct", "the direct solver"
    bears_mass = True
    captured = False

    @property
    def whole(self) -> bool:
        return self.mass or self.slow == 1

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        if not touches(self._prepare(changed), MATRIX):
            return
        # the pattern is symmetric, and every diagonal entry a fit pivot
        options = {"SymmetricMode": True}
        self.factor = splu(step_matrix(self).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def margins(self, k: int, dt: float) -> np.ndarray:
        q, facts = super().margins(k, dt), self.facts[k]
        if self.whole:
            q[0] += facts.b if self.mass else 2 * facts.b
        if not self.mass:
            fast = slice(1 if self.whole else 2, None)
            q[fast] += (facts.ring + facts.b)[fast]
        return q

    def bears_coupling(self, k: int, dt: float) -> bool:
        return self.bears_place(k, dt, tied=not self.whole)

    def solve_lines(self, state: State) -> None:
        n = self.model.nodes
        right = np.concatenate([state.delta.numpy(), state.low.numpy()]).astype(float)
        step = self.factor.solve(right).astype(np.float32)
        state.delta.assign(step[:n])
        state.low.assign(step[n:])
