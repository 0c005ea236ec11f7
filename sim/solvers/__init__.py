"""Integrators of (10) with mu = 0, one scheme a file, behind one interface."""

from __future__ import annotations

from ..model import Model
from .adi import SolverADI
from .base import Solver
from .euler import SolverEuler
from .jacobi import SolverJacobi

__all__ = ["SCHEMES", "Solver", "SolverADI", "SolverEuler", "SolverJacobi", "make_solver"]

SCHEMES: dict[str, type[Solver]] = {"adi": SolverADI, "jacobi": SolverJacobi, "euler": SolverEuler}


def make_solver(scheme: str, model: Model, dt: float | None, slow: float | None, momentum: float) -> Solver:
    """The solver named `scheme`.

    Raises:
        KeyError: no scheme of that name.
        ValueError: the scheme cannot bear the step `dt`.
    """
    return SCHEMES[scheme](model, dt, slow, momentum)
