"""How long a step may be, from the stiffness that it treats explicitly.

Without mass, v += -dt P^-1 (K + E) v shrinks in the energy of K + E, where K is what P has of the forces and E the rest,
if 2 P / dt - K - E is positive. With mass, the rule of `Solver` keeps its energy positive if A - (K + E) / 4 is. Both ask
that a margin in each mode, known in closed form, be stiffer than E. E is the image's pull, a load on two points of each
ring, whose stiffness in modes is a rank of two (so that it is the sum of compliances 1 / margin that counts), and what the
scheme's margins have taken off already: twist, upright rings. P holds enough of the tension of natural shapes
(`Model.stiffness`) for any step. (7) and (8), which tie places of rings and spine to one another without being the gradient
of an energy, are looked at for themselves (`place`).

Not in it, since it depends on the shape: contraction c < 0 of (9), whose stiffness is |c| over the radius.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STRETCH = 1.5
"""Most length of contour a unit of s, in lengths of the spine, that the image's load is taken for."""
RANGE = (1e-9, 1e3)
"""Steps that are looked at: a scheme without a limit in this range has none."""


def compliance(margin: np.ndarray, nx: int) -> float:
    """Compliance of two opposite points of a ring to a load that is even along s, times nx.

    Args:
        margin: stiffness of modes 0 to nx // 2 around, shape (nx // 2 + 1,), above 0.
        nx: nodes around.
    """
    count = np.full(len(margin), 2.0)
    count[0] = 1.0
    if nx % 2 == 0:
        count[-1] = 1.0
    each = count / margin
    return 2 * float(max(each[::2].sum(), each[1::2].sum()))


def place(reaction: float, a: float, b: float, depth: float, ring: float, image: float) -> np.ndarray:
    """Stiffness of (7), (8), the image's load and the ring's own in three unknowns, shape (3, 3), not symmetric.

    They are a ring's place, the second mode around of amplitude (cos 2 theta, sin 2 theta), which has the place's part
    across the ring and moves the centroid as far, and the spine's node.

    Args:
        reaction, a, b, depth: strengths.
        ring: elastic stiffness of the second mode.
        image: of the load on two opposite points, by unit of s.
    """
    tie = reaction + depth
    of_couplings = [[tie + b / 2, tie + b / 2, -reaction - b / 2], [b / 2, b / 2 + ring, -b / 2], [-a, -a, a]]
    return np.array(of_couplings) + 2 * image * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]])


def longest(bears: Callable[[float], bool]) -> float:
    """The least of the steps in `RANGE` that is not borne, by bisection; inf where all are, 0 where none is."""
    steps = np.geomspace(*RANGE, 121)
    good = [bears(float(step)) for step in steps]
    if all(good):
        return np.inf
    first = good.index(False)
    if first == 0:
        return 0.0
    low, high = steps[first - 1], steps[first]
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if bears(middle) else (low, middle)
    return float(low)


def around(tension: float, rigidity: float, nx: int) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of modes 0 to nx // 2 of an even ring, and their Laplacian's eigenvalues; shape (nx // 2 + 1,)."""
    lap = (2 * nx * np.sin(np.pi * np.arange(nx // 2 + 1) / nx)) ** 2
    return tension * lap + rigidity * lap**2, lap


def along(tension: float, rigidity: float, ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of each mode of an even line with natural ends, and its tension at w = 1; shape (ns,) each."""
    root = np.full(ns, 1.0)
    root[0] = root[-1] = np.sqrt(2)
    d1 = np.diff(np.eye(ns), axis=0) * (ns - 1) * root
    d2 = np.diff(np.eye(ns), 2, axis=0) * (ns - 1) ** 2 * root
    # a little tension parts the modes without any
    value, mode = np.linalg.eigh(rigidity * d2.T @ d2 + (tension + 1e-9 * rigidity + 1e-12) * d1.T @ d1)
    stretch = ((d1 @ mode) ** 2).sum(axis=0)
    return np.maximum(value, 0), stretch
