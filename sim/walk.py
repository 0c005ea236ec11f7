"""A random walker with priors (Grady 2005) on the samples of an image, weighted anew so that its map decides."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, cg

AHEAD = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns from a sample to the neighbours that come after it; the others come before."""
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
    pair: np.ndarray
    """which pair each sample makes with its neighbours to the right, below, below right and below left, shape (4, h, w); -1
    where none."""

    @staticmethod
    def on(x: np.ndarray, where: np.ndarray, known: np.ndarray) -> Walk:
        """The 8-neighbour graph with weights exp(-|dX|^2 / (2 PARTING mean |dX|^2)) + 1e-4, times `UNKNOWN` where unknown.

        Args:
            x: image, shape (h, w, channels).
            where: the samples to walk on, shape (h, w), bool.
            known: what may be looked at, shape (h, w), bool.
        """
        h, w = where.shape
        index, planes = np.cumsum(where).reshape(h, w) - 1, np.ascontiguousarray(np.moveaxis(x, 2, 0))
        firsts, seconds, squares, ties, total, count = [], [], [], [], 0.0, 0
        pair, made = np.full((len(AHEAD), h, w), -1, np.int32), 0
        for k, (dy, dx) in enumerate(AHEAD):
            a = (slice(0, h - dy), slice(max(0, -dx), w - max(0, dx)))
            b = (slice(dy, h), slice(max(0, dx), w + min(0, dx)))
            square = np.sum([(plane[a] - plane[b]) ** 2 for plane in planes], axis=0)
            total, count = total + square.sum(), count + square.size
            both = where[a] & where[b]
            firsts.append(index[a][both])
            seconds.append(index[b][both])
            squares.append(square[both])
            ties.append(np.where(known[a] & known[b], 1.0, UNKNOWN)[both])
            pair[k][a][both] = np.arange(made, made + len(firsts[-1]))
            made += len(firsts[-1])
        weight = np.exp(-np.concatenate(squares) / (2 * PARTING * total / count + 1e-12)) + 1e-4
        weight = weight * np.concatenate(ties)
        return Walk(where, np.concatenate(firsts), np.concatenate(seconds), weight, pair)

    @cached_property
    def _laid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns and starts of rows of the matrix, and which pair, or after them which sample, each entry is of."""
        h, w = self.where.shape
        column = np.cumsum(self.where, dtype=np.int32).reshape(h, w) - 1
        column = np.pad(np.where(self.where, column, -1), 1, constant_values=-1)
        pair = np.pad(self.pair, ((0, 0), (1, 1), (1, 1)), constant_values=-1)
        columns, sources = [], []
        for dy, dx in itertools.product((-1, 0, 1), repeat=2):
            there = slice(1 + dy, h + 1 + dy), slice(1 + dx, w + 1 + dx)
            if (dy, dx) in AHEAD:
                source = self.pair[AHEAD.index((dy, dx))]
            elif (dy, dx) == (0, 0):
                source = column[there] + np.int32(len(self.first))
            else:
                source = pair[AHEAD.index((-dy, -dx))][there]
            columns.append(column[there][self.where])
            sources.append(source[self.where])
        columns, sources = np.stack(columns, axis=1), np.stack(sources, axis=1)
        there = columns >= 0
        return columns[there], np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int32), sources[there]

    @cached_property
    def _blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which block each sample is in, counted by rows; pairs across blocks, and both their blocks, shape (2, pairs)."""
        rows, cols = np.indices(self.where.shape) // BLOCK
        place = (rows * (cols.max() + 1) + cols)[self.where]
        block = (np.cumsum(np.bincount(place) > 0) - 1)[place]
        both = np.stack([block[self.first], block[self.second]])
        across = np.flatnonzero(both[0] != both[1])
        return block, across, np.sort(both[:, across], axis=0)

    def _coarse(self, hold: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Factor of the system on blocks, in LAPACK's lower bands."""
        block, across, (low, high) = self._blocks
        count, wide = int(block.max()) + 1, int((high - low).max(initial=0)) + 1
        ties = weight[across]
        bands = -np.bincount((high - low) * count + low, ties, wide * count).reshape(wide, count)
        bands[0] = np.bincount(block, hold) + np.bincount(low, ties, count) + np.bincount(high, ties, count)
        return cholesky_banded(bands, overwrite_ab=True, lower=True, check_finite=False)

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
        guess, w, n, held = start[self.where], self.weight, int(self.where.sum()), hold[self.where]
        if again:
            w = w / np.maximum(1.0, np.abs(guess[self.first] - guess[self.second]) / DECIDED)
        own = held + np.bincount(self.first, w, n) + np.bincount(self.second, w, n)
        columns, starts, sources = self._laid
        a = sparse.csr_array((np.concatenate([-w, own])[sources], columns, starts), shape=(n, n))
        inverse, coarse, block = 1 / own, self._coarse(held, w), self._blocks[0]

        def rough(r: np.ndarray) -> np.ndarray:
            return inverse * r + cho_solve_banded((coarse, True), np.bincount(block, r), check_finite=False)[block]

        both = LinearOperator(a.shape, rough, dtype=float)  # pyright: ignore[reportCallIssue]
        found, _ = cg(a, held * prior[self.where], x0=guess, rtol=1e-4, maxiter=600, M=both)
        inside = np.zeros(self.where.shape)
        inside[self.where] = found
        return inside
