"""Integrators of (10), one scheme a file, behind one interface."""

from __future__ import annotations

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

SCHEMES: dict[str, type[Solver]] = {
    s.name: s for s in (SolverADI, SolverJacobi, SolverEuler, SolverSOR, SolverDirect)
}


def choose(model: Model) -> str:
    """The scheme that "auto" stands for."""
    return "adi"


def make_solver(scheme: str, model: Model, dt: float | None, slow: float | None, momentum: float) -> Solver:
    """The solver named `scheme`, or for "auto" the one that `choose` names.

    Raises:
        KeyError: no scheme of that name.
        ValueError: the scheme cannot bear the step `dt`, mass, or the material.
    """
    return SCHEMES[choose(model) if scheme == "auto" else scheme](model, dt, slow, momentum)
