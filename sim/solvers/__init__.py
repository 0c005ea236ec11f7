"""Integrators of (10), one scheme a file, behind one interface."""

from __future__ import annotations

import numpy as np

from ..model import Model
from .adi import SolverADI
from .base import Solver
from .direct import SolverDirect
from .euler import SolverEuler
from .jacobi import SolverJacobi
from .sor import SolverSOR

__all__ = [
    "SCHEMES", "Solver", "SolverADI", "SolverDirect", "SolverEuler", "SolverJacobi", "SolverSOR", "choose", "make_solver",
]  # fmt: skip

SCHEMES: dict[str, type[Solver]] = {s.name: s for s in (SolverADI, SolverJacobi, SolverEuler, SolverSOR, SolverDirect)}

LEAST = 0.25
"""Share of their usual step below which alternating directions are given up for the direct solver."""


def choose(model: Model) -> str:
    """The scheme that "auto" stands for: alternating directions, or the direct solver where they do not serve.

    They are the fastest at every grid and rigidity that was measured (`benchmarks.solvers`). They do not serve twist so
    stiff that it takes most of their step, nor mass or, with it, viscosity that vary over a tube.
    """
    if model.mu.numpy().any():
        weights = [(a.numpy()[model.nodes_of(k)]) for a in (model.mu, model.gamma) for k in range(model.tubes)]
        return "adi" if all(np.ptp(w) == 0 for w in weights) else "direct"
    if not model.w11.numpy().any():
        return "adi"
    return "adi" if SolverADI(model, None, None, 0.0).dt >= LEAST * SolverADI.default_dt else "direct"


def make_solver(scheme: str, model: Model, dt: float | None, slow: float | None, momentum: float) -> Solver:
    """The solver named `scheme`, or for "auto" the one that `choose` names.

    Raises:
        KeyError: no scheme of that name.
        ValueError: the scheme cannot bear the step `dt`, mass, or the material.
    """
    return SCHEMES[choose(model) if scheme == "auto" else scheme](model, dt, slow, momentum)
