"""The fast solver: every row to a certified duality gap, by an active set in the compiled core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.errors import InputError, SolverError
from lightmatrix.patterns.bits import PackedPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.loop import Progress
from lightmatrix.solvers.problem import Fidelity, Problem, Result, Status

# Patterns are prepared once for all tiles of a capture; the entry goes with the pattern set.
_prepared: WeakKeyDictionary[PatternSet, _core.PreparedPatterns] = WeakKeyDictionary()


@dataclass(frozen=True)
class ActiveSet:
    """Active-set solver of the convex fidelities; each row carries its duality gap.

    ::

        min over x >= 0, b >= 0 of  lambda sum x + sum_k w_k f_k(a_k . x + b m_k)

    A row alternates between a restricted solve on few pixels and a pass over all pixels, which
    finds the strongest violators and the dual value (for the method, see `docs/fast-solver.md`).
    It stops when its relative gap (P - D) / max(P, 1e-6 ||y||^2 / 2), in float64, is at most
    `tolerance`. A clipped sample's own value is its lower bound, so clip levels and exposures may
    differ from sample to sample. A row's solution depends on no other row: results depend neither
    on threads nor on tiles.

    Parameters
    ----------
    fidelity : Fidelity
        one-sided, rejection or linear; not `clipped`, which is not convex and has no gap, and not
        `likelihood`.
    tolerance : float
        Relative duality gap, in (0, 1).
    max_passes : int
        Passes over all pixels after which a row is given up as it is; at least 1.
    threads : int or None
        None takes one per core.

    Raises
    ------
    SolverError
        For the fidelities `clipped` and `likelihood`.
    InputError
        On parameters out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> result = lm.solve(lm.Problem(patterns, samples, regularization=0.01), lm.ActiveSet())
    >>> int(result.coefficients.toarray().argmax())
    5
    """

    fidelity: Fidelity = Fidelity.ONE_SIDED
    tolerance: float = 1e-4
    max_passes: int = 200
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.fidelity is Fidelity.LIKELIHOOD:
            raise SolverError(
                "the active-set solver cannot use the fidelity likelihood: its steps are exact for "
                "quadratic terms only",
                hint="use one-sided, or the solver saturation-admm",
            )
        if not self.fidelity.convex:
            raise SolverError(
                f"the active-set solver cannot use the fidelity {self.fidelity}: it is not convex, "
                "so no row could be certified",
                hint="use one-sided, or the solver saturation-admm",
            )
        if not 0 < self.tolerance < 1:
            raise InputError(
                f"a tolerance of {self.tolerance}", hint="use a relative gap such as 1e-4"
            )
        if self.max_passes < 1:
            raise InputError(f"max_passes is {self.max_passes}", hint="use at least 1")
        if self.threads is not None and self.threads < 1:
            raise InputError(f"{self.threads} threads", hint="use at least 1")

    def solve(
        self, problem: Problem, progress: Progress | None = None, *, start: Result | None = None
    ) -> Result:
        """Solve all rows.

        Parameters
        ----------
        problem : Problem
            M rows.
        progress : callable, optional
            Called with (finished, all) rows.
        start : Result, optional
            Where to start, such as the solution at another regularization. None: from nothing.

        Returns
        -------
        Result
            `iterations` are passes over all pixels; the coefficients are float64, as certified.
        """
        solved = prepared(problem.patterns).solve(
            np.ascontiguousarray(problem.samples.values),
            np.ascontiguousarray(problem.samples.clipped),
            sample_weights(problem),
            None if start is None else starting_rows(problem, start.coefficients, start.background),
            float(problem.regularization),
            str(self.fidelity),
            problem.nonnegative,
            problem.background,
            self.tolerance,
            self.max_passes,
            self.threads,
            progress,
        )
        return as_result(solved, problem)

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Samples as they come and as solved, scores of a row, and a generous support."""
        return 24 * patterns + 2 * pixels + 16 * 512


def prepared(patterns: PatternSet) -> _core.PreparedPatterns:
    """Patterns in the form the core works on, made once for each set."""
    known = _prepared.get(patterns)
    if known is None:
        known = _prepared[patterns] = prepare(patterns)
    return known


def prepare(patterns: PatternSet, instructions: str | None = None) -> _core.PreparedPatterns:
    """Patterns in the form the core works on.

    Parameters
    ----------
    patterns : PatternSet
        Sets of zeros and ones are kept as bits, all others as float32.
    instructions : {"portable", "avx2", "avx512"}, optional
        None takes the best this CPU has; all give the same scores.
    """
    means = np.ascontiguousarray(patterns.means, np.float64)
    pixels = patterns.pixels
    transform = None
    if isinstance(patterns, HadamardPatterns):
        transform = (patterns.transform_size, patterns.selected, patterns.position)
    bits = _bits(patterns)
    if bits is None:
        matrix = np.ascontiguousarray(patterns.dense())
        return _core.PreparedPatterns.from_dense(matrix, means, instructions)
    return _core.PreparedPatterns.from_bits(bits, pixels, means, transform, instructions)


def _bits(patterns: PatternSet) -> NDArray[np.uint8] | None:
    """Patterns of zeros and ones only as packed bits, (K, ceil(N / 8)); None for others."""
    if isinstance(patterns, PackedPatterns):
        return patterns.bits
    packed = []
    for _, block in patterns.blocks():
        lit = block == 1
        if not (lit | (block == 0)).all():
            return None
        packed.append(np.packbits(lit, axis=1, bitorder="little"))
    return np.concatenate(packed)


def sample_weights(problem: Problem) -> NDArray[np.float64] | None:
    """The weights as the core takes them."""
    if problem.samples.weights is None:
        return None
    return np.ascontiguousarray(np.atleast_2d(problem.samples.weights), np.float64)


def starting_rows(
    problem: Problem, coefficients: Any, background: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """A start as the core takes it."""
    shape = (problem.rows, problem.patterns.pixels)
    if coefficients.shape != shape:
        raise InputError(f"a start of shape {coefficients.shape} for a problem of {shape}")
    return (
        np.ascontiguousarray(coefficients.indptr, np.int64),
        np.ascontiguousarray(coefficients.indices, np.int32),
        np.ascontiguousarray(coefficients.data, np.float64),
        np.ascontiguousarray(background, np.float64),
    )


def as_result(solved: _core.Solved, problem: Problem) -> Result:
    """What the core has solved."""
    shape = (problem.rows, problem.patterns.pixels)
    narrow = solved.indptr[-1] <= np.iinfo(np.int32).max
    indptr = solved.indptr.astype(np.int32) if narrow else solved.indptr
    converged = solved.converged
    return Result(
        csr_array((solved.values, solved.indices, indptr), shape=shape),
        solved.background,
        solved.passes,
        converged,
        solved.objective,
        solved.gap,
        Status.CONVERGED if converged.all() else Status.ITERATION_LIMIT,
    )
