"""Fidelities: how samples are compared with predictions. Each is a `DataTerm` with a name."""

from __future__ import annotations

from lightmatrix.solvers.fidelity.data_term import DataTerm, Observed
from lightmatrix.solvers.fidelity.names import Fidelity

__all__ = ["DataTerm", "Fidelity", "Observed"]
