"""The matrix of a whole step as SciPy keeps it, for the schemes that take rings and meridians together."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ..model import SPINE_TO_RING, SYMMETRY
from .base import Solver, end_mass, slow_mean
from .factor import cyclic_bands, open_bands


def step_matrix(solver: Solver) -> sparse.csr_array:
    """M + dt K of all tubes and spines in float64, shape (N + 4 R, N + 4 R).

    Unknowns are those of `State.delta` and then `State.low`. A whole step has its tubes' modes in the first, but for closed
    ends, which are one unknown each in the first line of the second; otherwise the slow modes' lines are apart there, as
    alternating directions keep them. The spine is the fourth line. An unknown without use has a row of the identity.
    K is (4), (5) and what of (7), (8) ties a node to its own rest.
    """
    m = solver.model
    size = m.nodes + 4 * m.rings
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    coupling = m.coupling.numpy().astype(float)
    host = m.stiffness(solver.share)
    scale = np.ones(size)
    for k, (nx, ns) in enumerate(m.grids):
        dt, slow_dt, spine_dt = map(float, solver.steps[k])
        nodes, rings = m.nodes_of(k), m.rings_of(k)
        w = {key: host[key][nodes].reshape(ns, nx) for key in ("w10", "w20", "w11", "w01", "w02")}
        closed = m.host_ring_closed[rings]
        mass = end_mass(ns)[:, None]
        at = np.arange(ns * nx).reshape(ns, nx)
        bands = [band * mass * ~closed[:, None] for band in cyclic_bands(w["w10"], w["w20"], 1 / nx)]
        b = coupling[rings, SYMMETRY, None] * ~closed[:, None]
        entries = [(at, at, mass * (solver.weight[nodes].reshape(ns, nx) + dt * b))]
        entries += [(at, at, dt * bands[0]), *_pairs(at, np.roll(at, -1, 1), dt * bands[1])]
        entries += _pairs(at, np.roll(at, -2, 1), dt * bands[2])
        bands = [band.T for band in open_bands(w["w01"].T, w["w02"].T, 1 / (ns - 1))]
        entries += [(at, at, dt * bands[0]), *_pairs(at[:-1], at[1:], dt * bands[1][:-1])]
        entries += _pairs(at[:-2], at[2:], dt * bands[2][:-2])
        if w["w11"].any():
            corners = (at[1:], np.roll(at, -1, 1)[1:], at[:-1], np.roll(at, -1, 1)[:-1])
            cell = dt * 2 * (nx * (ns - 1)) ** 2 * w["w11"][:-1]
            entries += [
                (i, j, a * b * cell)
                for i, a in zip(corners, (-1, 1, 1, -1), strict=True)
                for j, b in zip(corners, (-1, 1, 1, -1), strict=True)
            ]
        # a closed end's nodes are one unknown, or none where its mean is a line's
        unknown = np.arange(nodes.start, nodes.stop).reshape(ns, nx)
        low = m.nodes + np.arange(rings.start, rings.stop)
        unknown[closed] = low[closed, None] if solver.whole else -1
        scale[low[closed]] = 1 / nx
        parts += [(unknown.flat[i], unknown.flat[j], v) for i, j, v in entries]
        inertia = solver.low_weight[:, rings]
        lines = [(3, host["w1"][rings], host["w2"][rings], spine_dt, coupling[rings, SPINE_TO_RING], False)]
        if not solver.whole:
            scale[low] = 1
            means = slow_mean(w["w01"]), slow_mean(w["w02"])
            lines += [(0, *means, slow_dt, solver.tie()[rings], False)]
            lines += [(line, *means, slow_dt, np.zeros(ns), closed.any()) for line in (1, 2)]
        for line, tension, rigidity, step, extra, held in lines:
            at = low + line * m.rings
            if held:
                at = np.where(closed, -1, at)
            diagonal, first, second = (step * b[0] for b in open_bands(tension[None], rigidity[None], 1 / (ns - 1)))
            diagonal = diagonal + end_mass(ns) * (inertia[line] + step * extra)
            parts += [(at, at, diagonal), *_pairs(at[:-1], at[1:], first[:-1]), *_pairs(at[:-2], at[2:], second[:-2])]
    row, column, value = (np.concatenate([np.ravel(part[c]) for part in parts]) for c in range(3))
    used = (row >= 0) & (column >= 0)
    matrix = sparse.coo_array((value[used], (row[used], column[used])), shape=(size, size)).tocsr()
    matrix = sparse.diags_array(scale) @ matrix + sparse.diags_array((matrix.diagonal() == 0).astype(float))
    return sparse.csr_array(matrix)


def _pairs(i: np.ndarray, j: np.ndarray, value: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    return [(i, j, value), (j, i, value)]
