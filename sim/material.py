"""Material of spine and tube and strengths of their coupling: free of units and of resolution (design.md)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Weights of (2), (3) and strengths of (7)-(9), each per unit of material coordinate.

    Forces are linear in length, so one set serves every size and every grid. The energies' factor two is left
    out, as the paper's (4) and (5) do.
    """

    w1: float = 0.0
    """tension of the spine (2)."""
    k1: float = 1e-2
    """K1 of the spine's least lengths L1: it pushes nodes apart before they meet, and has no tension otherwise."""
    w2: float = 3e-6
    """rigidity of the spine (2)."""
    w10: float = 0.0
    """tension of the tube around (3)."""
    w01: float = 0.0
    """tension of the tube along (3)."""
    w20: float = 1e-4
    """rigidity of the tube around (3)."""
    w11: float = 0.0
    """twist rigidity of the tube (3); explicit, so keep it below 1e-7."""
    w02: float = 1e-7
    """rigidity of the tube along (3)."""
    mu: float = 0.0
    """mass density of spine and tube (1); 0 is the motion of first order, in which dt is no time."""
    gamma: float = 1.0
    """viscosity of the medium (1)."""
    a: float = 1.0
    """spine to centroid of its ring (7)."""
    reaction: float = 0.1
    """share of `a` that acts back on the tube (7); 1 is the paper's."""
    b: float = 1.0
    """radial symmetry (8)."""
    c: float = 0.0
    """expansion (> 0) or contraction (9), in units of the initial length of the spine."""
    c_balance: float = 1.0
    """share of the tube's own contraction around the spine that (9) cancels; 0 is the paper's plain c."""
    d: float = 0.05
    """rings upright on the spine (ours): -d (r.t) t."""
    centre: float = 0.5
    """a closed end in the middle of its cap (ours): springs to the next ring, of their mean length."""
    depth: float = 0.1
    """the spine at the depth it was given, which a lone view cannot see (ours); no part of it in several views."""
    closed: bool = True
    """ends cinched shut, the limit c(0), c(1) -> -infinity of (9): an end ring moves as one node."""
