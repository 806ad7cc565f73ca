"""How samples are compared with predictions: a small class for each way, and their names."""

from __future__ import annotations

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed
from lightmatrix.solvers.fidelity.names import Fidelity

__all__ = ["DataTerm", "Fidelity", "Observed"]
