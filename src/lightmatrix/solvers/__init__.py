"""Solvers of rows of the light transport matrix. All take a `Problem` and return a `Result`."""

from lightmatrix.solvers.active_set import ActiveSet
from lightmatrix.solvers.admm import ADMM, SaturationADMM
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.loop import Solver, solve
from lightmatrix.solvers.problem import Problem, Result, Status
from lightmatrix.solvers.romp import ROMP
from lightmatrix.solvers.total_variation import TotalVariation

__all__ = [
    "ADMM", "ROMP", "ActiveSet", "Fidelity", "Problem", "Result", "SaturationADMM", "Solver",
    "Status", "TotalVariation", "solve",
]  # fmt: skip
