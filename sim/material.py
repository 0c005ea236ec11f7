"""Material of spine and tube and strengths of their coupling: free of units and of resolution (design.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Value = float | Sequence[Any] | np.ndarray
"""A number; a list along s; for weights of the tube also N_x lists along s, shape (N_x, N_s). See `sim.fields.as_field`."""
Weight = Value | Mapping[str, Any] | Callable[[float], Any]
"""A value; {"times": [...], "values": [...]}, linear between; or a function of the solver's time that gives a value."""


@dataclass(frozen=True)
class Material:
    """Weights of (2), (3), strengths of (7)-(9) and natural shapes (section 3), each per unit of material coordinate.

    Forces are linear in length, so one set serves every size and every grid. The energies' factor two is left
    out, as the paper's (4) and (5) do. Every weight is a field over s, or x and s, and may change over time.
    Natural lengths and curvatures count in initial lengths of the spine; None: no such natural shape.
    """

    w1: Weight = 0.0
    """tension of the spine (2)."""
    k1: Weight = 1e-2
    """K1 of w1 = K1 (|dv/ds| - L1), where L1 is given; in any case it pushes nodes apart before they meet."""
    L1: Weight | None = None
    """natural |dv/ds| of the spine; 1 is the initial length."""
    w2: Weight = 3e-6
    """rigidity of the spine (2)."""
    C2: Weight | None = None
    """natural curvature of the spine, in whatever plane it bends: what a spine of length 1 turns by from end to end [rad];
    0 is the paper's plain (2), its sign tells one side from the other. None: an even bend becomes its natural one."""
    w10: Weight = 0.0
    """tension of the tube around (3)."""
    k10: Weight = 0.0
    """K10 of w10 = K10 (|dv/dx| - L10), where L10 is given."""
    L10: Weight | None = None
    """natural |dv/dx| of the tube: the circumference of its rings."""
    w01: Weight = 0.0
    """tension of the tube along (3)."""
    k01: Weight = 0.0
    """K01 of w01 = K01 (|dv/ds| - L01), where L01 is given."""
    L01: Weight | None = None
    """natural |dv/ds| of the tube: the length of its meridians."""
    w20: Weight = 1e-4
    """rigidity of the tube around (3)."""
    C20: Weight | None = None
    """natural curvature around, -n.d2v/dx2 on the outward normal n: (2 pi)^2 r for a ring of radius r."""
    w11: Weight = 0.0
    """twist rigidity of the tube (3); explicit, so keep it below 1e-7."""
    C11: Weight | None = None
    """natural twist, -n.d2v/dxds."""
    w02: Weight = 1e-7
    """rigidity of the tube along (3)."""
    C02: Weight | None = None
    """natural curvature along, -n.d2v/ds2: above 0 a meridian bulges outward."""
    mu: Weight = 0.0
    """mass density of tube and spine (1); 0 is the motion of first order, in which dt is no time."""
    gamma: Weight = 1.0
    """viscosity of the medium (1)."""
    a: Weight = 1.0
    """spine to centroid of its ring (7)."""
    reaction: Weight = 0.1
    """share of `a` that acts back on the tube (7); 1 is the paper's."""
    b: Weight = 1.0
    """radial symmetry (8)."""
    c: Weight = 0.0
    """expansion (> 0) or contraction (9), in units of the initial length of the spine."""
    c_balance: Weight = 1.0
    """share of the tube's own contraction around the spine that is taken away; 0 is the paper's plain c.
    That by w20 counts the ring's own first harmonic as natural (not where C20 is given), that by w10 is pushed against."""
    d: Weight = 0.05
    """rings upright on the spine (ours): -d (r.t) t."""
    centre: Weight = 0.5
    """a closed end in the middle of its cap (ours): springs to the next ring, of their mean length."""
    depth: Weight = 0.1
    """the spine at the depth it was given, which a lone view cannot see (ours); in views from almost one side the
    ends at the depth that the body, told better, leads to; no part of it in views all around."""
    closed: bool = True
    """ends cinched shut, the limit c(0), c(1) -> -infinity of (9): an end ring moves as one node."""


@dataclass(frozen=True)
class Break:
    """A discontinuity across the object (section 3), written into the weights as zeros."""

    at: float | tuple[float, float]
    """share of the object's length along the axis, from its first end, or an image point (column, row) beside the place."""
    order: Literal["position", "tangent"] = "position"
    """"position": w1 = w2 = 0, parts come apart; "tangent": w2 = 0, a crease."""
    of: Literal["both", "tube", "spine"] = "both"
    """what breaks."""
    time: float = 0.0
    """of the solver, from which on it is broken."""
