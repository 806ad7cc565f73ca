"""The loop of all iterative solvers: iteration limits, stopping row by row, finiteness."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.progress import Progress
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.solvers.problem import Problem, Result, Status, no_rows, objective, solved_rows
from lightmatrix.transport.sparse_rows import SparseRows

S = TypeVar("S")


class Solver(Protocol):
    """Solves all rows of a problem; a frozen dataclass of parameters."""

    def solve(self, problem: Problem, progress: Progress | None = None) -> Result:
        """Solve all rows; `progress` is called with (finished, all) rows."""

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Working memory of one row in bytes."""


def solve(problem: Problem, solver: Solver, *, progress: Progress | None = None) -> Result:
    """Solve a problem.

    Parameters
    ----------
    problem : Problem
        M rows.
    solver : Solver
        A frozen dataclass of parameters.
    progress : callable, optional
        Called with (finished, all) rows.

    Returns
    -------
    Result

    Raises
    ------
    SolverError
        If the solver cannot solve this kind of problem.

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
    return solver.solve(problem, progress)


class IterativeSolver(ABC):
    """A solver of steps that all rows take together. States are frozen dataclasses of M rows."""

    # The data term that is minimised.
    fidelity: Fidelity | str
    # Limit of iterations. A row that reaches it is returned as it is.
    max_iterations: int
    # A row stops when both its residuals are at most this.
    tolerance: float

    @abstractmethod
    def init(self, problem: Problem) -> Any:
        """The state before the first step."""

    @abstractmethod
    def step(self, problem: Problem, state: Any) -> Any:
        """The state after one iteration."""

    @abstractmethod
    def residuals(
        self, problem: Problem, before: Any, after: Any
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Relative primal and dual residual of each row, (M,) each."""

    @abstractmethod
    def solution(self, problem: Problem, state: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Coefficients (M, N), mostly exact zeros, and background (M,)."""

    def objective(
        self, problem: Problem, x: csr_array, background: NDArray[Any]
    ) -> NDArray[np.float64]:
        """What is minimised, (M,)."""
        return objective(problem, x, background, self.fidelity)

    def solve(self, problem: Problem, progress: Progress | None = None) -> Result:
        """Solve all rows; `progress` is called with (finished, all) rows."""
        finished = _Finished(problem, self)
        active, part, state = np.arange(problem.rows), problem, self.init(problem)
        running = np.ones(problem.rows, bool)
        finite = True
        for iteration in range(1, self.max_iterations + 1):
            # In this order no third state stays in memory.
            before = state
            state = self.step(part, before)
            primal, dual = self.residuals(part, before, state)
            converged = running & (primal <= self.tolerance) & (dual <= self.tolerance)
            broken = running & ~(np.isfinite(primal) & np.isfinite(dual))
            finite &= not broken.any()
            last = iteration == self.max_iterations
            stopping = running if last else converged | broken
            if stopping.any():
                index = np.flatnonzero(stopping)
                stopped = state_of_rows(state, index)
                finished.add(active[index], part.take(index), stopped, iteration, converged[index])
                running = running & ~stopping
                if progress is not None:
                    progress(finished.count, problem.rows)
            if not running.any():
                break
            # Stopped rows stay in the batch until they make up this share of it: removing them
            # copies the state. Chosen by hand.
            if (~running).mean() > 0.2:
                keep = np.flatnonzero(running)
                active, part, state = active[keep], part.take(keep), state_of_rows(state, keep)
                running = np.ones(len(keep), bool)
        return finished.result(finite)


def state_of_rows(state: S, rows: NDArray[np.integer]) -> S:
    """The state of some rows: arrays are indexed, all other fields are shared."""
    arrays = {
        one.name: getattr(state, one.name)[rows]
        for one in fields(state)  # type: ignore[arg-type]
        if isinstance(getattr(state, one.name), np.ndarray)
    }
    return replace(state, **arrays)  # type: ignore[type-var]


@dataclass
class _Finished:
    """The rows that have stopped, in the order in which they stopped."""

    problem: Problem
    solver: IterativeSolver
    order: list[NDArray[np.integer]] = field(default_factory=list)
    parts: list[SparseRows] = field(default_factory=list)

    @property
    def count(self) -> int:
        return sum(map(len, self.order))

    def add(
        self, rows: NDArray[np.integer], problem: Problem, state: Any, iteration: int,
        converged: NDArray[np.bool_],
    ) -> None:  # fmt: skip
        coefficients, background = self.solver.solution(problem, state)
        x = csr_array(np.where(np.isfinite(coefficients), coefficients, 0))
        background = np.where(np.isfinite(background), background, 0)
        part = solved_rows(
            x, background, iterations=np.full(len(rows), iteration, np.int32), converged=converged,
            objective=self.solver.objective(problem, x, background),
        )  # fmt: skip
        self.order.append(rows)
        self.parts.append(part)

    def result(self, finite: bool) -> Result:
        rows = no_rows(self.problem)
        if self.parts:
            place = np.argsort(np.concatenate(self.order))
            rows = SparseRows.joined(self.parts).rows(place)
        if not finite:
            status = Status.NOT_FINITE
        elif rows.diagnostics["converged"].all():
            status = Status.CONVERGED
        else:
            status = Status.ITERATION_LIMIT
        return Result(rows, status)
