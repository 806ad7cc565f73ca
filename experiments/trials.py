"""Patterns of many small problems: each group of rows has its own pattern matrix."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.patterns.pattern_set import PatternSet


@dataclass(frozen=True, eq=False)
class TrialPatterns(PatternSet):
    """One matrix A per trial, for solvers that process all rows at every step.

    Rows come in the order of the trials, equally many per trial. A solver must not stop single
    rows, because the remaining ones would no longer match their matrices.
    """

    # (trials, K, N)
    stack: NDArray[Any]

    @property
    def shape(self) -> tuple[int, int]:  # type: ignore[override]
        return 1, int(self.stack.shape[2])

    @property
    def count(self) -> int:  # type: ignore[override]
        return int(self.stack.shape[1])

    @cached_property
    def gram(self) -> NDArray[np.float64]:
        """A A' of each trial, (trials, K, K)."""
        stack = self.stack.astype(np.float64)
        return stack @ stack.transpose(0, 2, 1)

    def forward(self, x: NDArray[Any]) -> NDArray[Any]:
        return self._grouped(x, self.stack.transpose(0, 2, 1))

    def adjoint(self, e: NDArray[Any]) -> NDArray[Any]:
        return self._grouped(e, self.stack)

    def _grouped(self, rows: NDArray[Any], matrices: NDArray[Any]) -> NDArray[Any]:
        groups = rows.reshape(len(matrices), -1, rows.shape[1])
        return (groups @ matrices.astype(rows.dtype, copy=False)).reshape(len(rows), -1)

    def columns(self, index: NDArray[np.integer]) -> NDArray[np.float32]:
        raise TypeError("trials share no columns")

    def rows(self, start: int, stop: int) -> NDArray[np.float32]:
        raise TypeError("trials share no rows")

    @property
    def description(self) -> dict[str, Any]:
        return {"kind": "trials", "trials": len(self.stack), "count": self.count}
