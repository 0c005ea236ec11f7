"""A random walker with priors (Grady 2005) on the samples of an image, weighted anew so that its map decides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

BLOCK = 8
"""Side of a block of samples that the solver takes as one first."""
PARTING = 0.4
"""Mean square of the differences between neighbours at which they part, times that of the whole image."""
UNKNOWN = 0.03
"""Weight of ties through samples that are not to be looked at: they carry the map across, but lead nobody else's in."""
DECIDED = 0.02
"""Difference of the map between neighbours above which their edge counts by the difference, not by its square."""


@dataclass(frozen=True)
class Walk:
    """Samples, and how strongly neighbours among them hang together."""

    where: np.ndarray
    """the samples that are walked on, shape (h, w), bool; the others count as background."""
    first: np.ndarray
    """one sample of each pair of neighbours, by its place among those walked on."""
    second: np.ndarray
    """the other."""
    weight: np.ndarray
    """of each pair."""
    block: np.ndarray
    """which block each sample is in."""

    @staticmethod
    def on(x: np.ndarray, where: np.ndarray, known: np.ndarray) -> Walk:
        """The 8-neighbour graph with weights exp(-|dX|^2 / (2 PARTING mean |dX|^2)) + 1e-4, times `UNKNOWN` where unknown.

        Args:
            x: image, shape (h, w, channels).
            where: the samples to walk on, shape (h, w), bool.
            known: what may be looked at, shape (h, w), bool.
        """
        h, w = where.shape
        index = np.cumsum(where).reshape(h, w) - 1
        firsts, seconds, squares, ties, total, count = [], [], [], [], 0.0, 0
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, h - dy), slice(max(0, -dx), w - max(0, dx)))
            b = (slice(dy, h), slice(max(0, dx), w + min(0, dx)))
            square = ((x[a] - x[b]) ** 2).sum(-1)
            total, count = total + square.sum(), count + square.size
            both = where[a] & where[b]
            firsts.append(index[a][both])
            seconds.append(index[b][both])
            squares.append(square[both])
            ties.append(np.where(known[a] & known[b], 1.0, UNKNOWN)[both])
        weight = np.exp(-np.concatenate(squares) / (2 * PARTING * total / count + 1e-12)) + 1e-4
        weight *= np.concatenate(ties)
        rows, cols = np.indices((h, w)) // BLOCK
        block = np.unique((rows * (cols.max() + 1) + cols)[where], return_inverse=True)[1]
        return Walk(where, np.concatenate(firsts), np.concatenate(seconds), weight, block)

    @cached_property
    def _laid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns and starts of rows of the matrix, and which of pairs, pairs turned round and diagonal stands where."""
        at = np.arange(len(self.block))
        rows, columns = (np.concatenate(v) for v in ((self.first, self.second, at), (self.second, self.first, at)))
        laid = sparse.csr_array((np.arange(len(rows)), (rows, columns)), shape=(len(at), len(at)))
        laid.sort_indices()
        return laid.indices, laid.indptr, laid.data

    def solve(self, hold: np.ndarray, prior: np.ndarray, start: np.ndarray, again: bool) -> np.ndarray:
        """The map x that minimises sum w (x_i - x_j)^2 + sum hold (x - prior)^2, shape (h, w); 0 off the walk.

        Args:
            hold: weight of the prior at each sample, shape (h, w).
            prior: shape (h, w), in [0, 1].
            start: a first guess, shape (h, w).
            again: weigh edges by 1 / |x_i - x_j| of the start where that is large. Repeated, this minimises the sum of
                differences and not of their squares: the map steps at edges and does not hesitate between them.

        By conjugate gradients, preconditioned by the diagonal and by the system on blocks of samples.
        """
        guess, w, n = start[self.where], self.weight, len(self.block)
        if again:
            w = w / np.maximum(1.0, np.abs(guess[self.first] - guess[self.second]) / DECIDED)
        own = hold[self.where] + np.bincount(self.first, w, n) + np.bincount(self.second, w, n)
        indices, starts, order = self._laid
        a = sparse.csr_array((np.concatenate([-w, -w, own])[order], indices, starts), shape=(n, n))
        inverse, coarse = 1 / own, []

        def rough(r: np.ndarray) -> np.ndarray:
            if not coarse:  # a good guess needs none
                whole = sparse.csr_array((np.ones(n), (np.arange(n), self.block)))
                coarse.append(splu((whole.T @ a @ whole).tocsc()))
            return inverse * r + coarse[0].solve(np.bincount(self.block, r))[self.block]

        both = LinearOperator(a.shape, matvec=rough)  # pyright: ignore[reportCallIssue]
        found, _ = cg(a, (hold * prior)[self.where], x0=guess, rtol=1e-4, maxiter=600, M=both)
        inside = np.zeros(self.where.shape)
        inside[self.where] = found
        return inside
