"""`SparseRows`, some rows of a light transport matrix, and helpers for sparse rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from lightmatrix.errors import InputError

_DIAGNOSTIC = "diagnostic_"


@dataclass(frozen=True, eq=False)
class SparseRows:
    """m rows of a light transport matrix: sparse coefficients, background and diagnostics."""

    # (m, N) in units of camera sample per unit of projector pixel.
    coefficients: csr_array
    # (m, B).
    background: NDArray[Any]
    # Facts about each row, such as its gap, (m,) each.
    diagnostics: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of rows m."""
        return int(self.coefficients.shape[0])

    def check(self) -> None:
        """Refuse parts that do not fit together or are not finite, as in a damaged file."""
        try:
            self.coefficients.check_format(full_check=True)
        except ValueError as error:
            raise _damaged(f"invalid sparse rows: {error}") from error
        if self.background.ndim != 2 or len(self.background) != self.count:
            raise _damaged(f"a background of shape {self.background.shape} for {self.count} rows")
        for name, values in self.diagnostics.items():
            if values.shape != (self.count,):
                raise _damaged(
                    f"a diagnostic {name!r} of shape {values.shape} for {self.count} rows"
                )
        for part in (self.coefficients.data, self.background):
            if part.dtype not in (np.float32, np.float64) or not np.isfinite(part).all():
                raise _damaged("coefficients that are not finite numbers")

    def rows(self, index: slice | NDArray[np.integer]) -> SparseRows:
        """Some of the rows, in the order of the index."""
        return SparseRows(
            csr_array(self.coefficients[index]),
            self.background[index],
            {name: values[index] for name, values in self.diagnostics.items()},
        )

    def single(self) -> SparseRows:
        """The same rows in single precision."""
        coefficients = csr_array(self.coefficients, dtype=np.float32)
        return SparseRows(coefficients, self.background.astype(np.float32), self.diagnostics)

    @classmethod
    def joined(cls, parts: Sequence[SparseRows]) -> SparseRows:
        """The rows of one or more parts, which have the same diagnostics, below each other.

        A single part is returned as it is, so that T is not in memory twice.
        """
        if len(parts) == 1:
            return parts[0]
        return cls(
            stack_rows([part.coefficients for part in parts]),
            np.concatenate([part.background for part in parts]),
            {
                name: np.concatenate([part.diagnostics[name] for part in parts])
                for name in parts[0].diagnostics
            },
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The rows as named arrays, for `from_arrays`."""
        return {
            "data": self.coefficients.data,
            "indices": self.coefficients.indices,
            "indptr": self.coefficients.indptr,
            "shape": np.array(self.coefficients.shape),
            "background": self.background,
            **{_DIAGNOSTIC + name: values for name, values in self.diagnostics.items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rows from the arrays of `arrays()`; refuses arrays that are missing or do not fit."""
        try:
            parts = arrays["data"], arrays["indices"], arrays["indptr"]
            count, pixels = (int(size) for size in arrays["shape"])
            rows = cls(
                csr_array(parts, shape=(count, pixels)),
                arrays["background"],
                {
                    name.removeprefix(_DIAGNOSTIC): values
                    for name, values in arrays.items()
                    if name.startswith(_DIAGNOSTIC)
                },
            )
        except (KeyError, TypeError, ValueError) as error:
            raise _damaged(f"arrays that do not hold sparse rows: {error}") from error
        rows.check()
        return rows


def stack_rows(parts: Sequence[csr_array]) -> csr_array:
    """Sparse matrices of equal width, stacked below each other, with 32-bit indices if they fit.

    SciPy may give 64-bit ones, which take half as much memory again, and products longer.
    """
    stacked = csr_array(vstack(parts, format="csr"))
    if max(stacked.nnz, *stacked.shape) <= np.iinfo(np.int32).max:
        places = (stacked.indices, stacked.indptr)
        stacked.indices, stacked.indptr = (part.astype(np.int32, copy=False) for part in places)
    return stacked


def footprint_sizes(rows: csr_array) -> NDArray[np.float64]:
    """The effective number of projector pixels in each row, (M,): (sum t)^2 / sum t^2.

    A Gaussian spot of standard deviation s counts about 4 pi s^2; rows without light have 0.
    """
    light = np.asarray(rows.sum(axis=1), np.float64).ravel()
    squares = np.asarray(rows.multiply(rows).sum(axis=1), np.float64).ravel()
    return np.where(squares > 0, light**2 / np.where(squares > 0, squares, 1), 0)


def row_blocks(ends: NDArray[np.integer], most: int) -> NDArray[np.int64]:
    """Rows from 0 to M that cut a CSR matrix (its indptr) into blocks of about `most` entries."""
    parts = max(1, -(-int(ends[-1]) // most))
    inner = np.linspace(0, ends[-1], parts + 1)[1:-1]
    return np.unique([0, *np.searchsorted(ends, inner), len(ends) - 1])


def _damaged(what: str) -> InputError:
    return InputError(what, hint="the file is damaged: create it again")
