"""Successive over-relaxation (section 5), coloured so that it is a parallel scheme of local operations."""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

import numpy as np
import warp as wp

from ...kernels import integrate
from ..model import Model, State
from .base import MATRIX, Solver, touches
from .matrix import step_matrix

BLOCK = 5
"""Fewest colours of the stencil: its nodes within two of one another, counted along x and s, are five of a kind."""


def colors(nx: int, ns: int) -> np.ndarray:
    """A colour of each node, shape (ns, nx), such that no two of one colour meet in the matrix, cyclic in x.

    The stencil reaches two nodes along x and s and the diagonal neighbours (13 nodes). Rings are one sequence, shifted by
    two nodes from each to the next, so that it must not repeat a colour within four nodes round the ring: blocks of five
    or more, each 0, 1, 2, ..., as even as nx allows. That takes 5 colours where 5 divides nx, 6 from 20 on, 9 at most.
    """
    blocks = nx // BLOCK
    sequence = np.concatenate([np.arange(len(b)) for b in np.array_split(np.arange(nx), blocks)])
    return sequence[(np.arange(nx) + 2 * np.arange(ns)[:, None]) % nx]


class SolverSOR(Solver):
    """Sweeps of over-relaxation over P = M + dt K, from a step of 0; each node is corrected at once.

    With `sweeps` many it is the direct solver's step. With one, it is the paper's scheme: forces are found anew between
    sweeps. Bears any step of the elastic forces: of a sweep's matrix D / omega + L, twice that less K leaves
    (1 + e) / dt + e D with e = 2 / omega - 1 for explicit forces (Householder and John's theorem).
    """

    name, title, remedy = "sor", "over-relaxation", ' or use solver.scheme = "adi"'
    omega = 1.5
    """Relaxation factor, in 0 to 2; lines of slow modes, where they are apart, have 1."""
    sweeps = 1
    """Sweeps a step."""

    @property
    def whole(self) -> bool:
        return self.slow == 1

    def __init__(self, model: Model, dt: float | None, slow: float | None, momentum: float):
        size = model.nodes + 4 * model.rings
        self.x, self.right = (wp.zeros(size, dtype=wp.vec3, device=model.device) for _ in range(2))
        self.row = wp.zeros(size + 1, dtype=int, device=model.device)
        self.column, self.entry = (wp.zeros(1, dtype=t, device=model.device) for t in (int, float))
        self.inverse = wp.zeros(size, dtype=float, device=model.device)
        nodes = [colors(nx, ns).ravel() for nx, ns in model.grids]
        self.node_colors = int(max(c.max() for c in nodes)) + 1
        # four lines of each tube, closed ends among them, have three colours that no node has
        s = np.concatenate([np.arange(ns) for _, ns in model.grids])
        color = np.concatenate([*nodes, np.tile(self.node_colors + s % 3, 4)])
        order = np.argsort(color, kind="stable")
        self.order = wp.array(order.astype(np.int32), dtype=int, device=model.device)
        self.starts = np.concatenate([[0], np.cumsum(np.bincount(color))])
        super().__init__(model, dt, slow, momentum)

    @property
    def form(self) -> tuple:
        return *super().form, len(self.entry)

    def material_changed(self, changed: Collection[str] | None = None) -> None:
        if not touches(self._prepare(changed), MATRIX):
            return
        matrix = step_matrix(self)
        self.diagonal = matrix.diagonal()
        if matrix.nnz != len(self.entry):  # else a graph may hold the arrays
            self.column, self.entry = (wp.zeros(matrix.nnz, dtype=t, device=self.model.device) for t in (int, float))
        self.row.assign(matrix.indptr.astype(np.int32))
        self.column.assign(matrix.indices.astype(np.int32))
        self.entry.assign(matrix.data.astype(np.float32))
        self.inverse.assign((1 / self.diagonal).astype(np.float32))

    def margins(self, k: int, dt: float) -> np.ndarray:
        q = super().margins(k, dt)
        nx, nodes = self.model.grids[k][0], self.model.nodes_of(k)
        w10, w20 = (float(self.spare[name][nodes].min()) for name in ("w10", "w20"))
        own = 2 * w10 * nx**2 + 6 * w20 * nx**4 + self.facts[k].b
        fast = slice(0 if self.whole else 2, None)
        q[fast] += (2 / self.omega - 1) * own - (1 - 1 / self.omega) * self.inert(k, dt)
        return q

    def bears_coupling(self, k: int, dt: float) -> bool:
        return self.whole or self.bears_place(k, dt, over=self.omega)

    def solve_lines(self, state: State) -> None:
        n, low = self.model.nodes, 4 * self.model.rings
        wp.copy(self.right, state.delta, 0, 0, n)
        wp.copy(self.right, state.low, n, 0, low)
        self.x.zero_()
        for _ in range(self.sweeps):
            for c, (first, end) in enumerate(pairwise(self.starts)):
                wp.launch(
                    integrate.relax_color,
                    int(end - first),
                    inputs=[
                        self.order, self.row, self.column, self.entry, self.inverse,
                        self.right, int(first), self.omega if self.whole or c < self.node_colors else 1.0,
                    ],
                    outputs=[self.x],
                    device=self.model.device,
                )  # fmt: skip
        wp.copy(state.delta, self.x, 0, 0, n)
        wp.copy(state.low, self.x, 0, n, low)
