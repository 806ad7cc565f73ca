"""Regularized orthogonal matching pursuit (Needell & Vershynin 2010), for many rows at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import SolverError
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_at_least_one
from lightmatrix.solvers import problem as problems
from lightmatrix.solvers.fidelity import Fidelity
from lightmatrix.transport.sparse_rows import SparseRows


@dataclass(frozen=True)
class ROMP:
    """Greedy sparse estimation. It does not use the problem's regularization.

    For each row: I = {}, r = y. Repeat: u = A'r; J = the n largest |u|; among the subsets of J
    whose members differ by at most a factor of two, add the one of greatest energy to I; x = least
    squares on I; r = y - A x. Stop at r ~ 0, at |I| >= 2 n or after `max_iterations` rounds.

    With a background, its column is always part of the least squares. If light is not negative,
    only positive correlations count, and at the end pixels with negative coefficients are removed
    and the others solved again.

    Parameters
    ----------
    sparsity : int or None
        n, the expected number of non-zeros. None: an eighth of the samples, at most 32.
    fidelity : Fidelity
        linear (clipped samples count like others) or rejection (they do not count).
    max_iterations : int or None
        Limit of rounds. None: n, as in the paper by Needell and Vershynin.
    tolerance : float
        A row stops when its residual falls below this share of its samples.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32)).bin(camera=16)
    >>> problem = lm.Problem(capture.patterns, capture.samples(), regularization=0.1)
    >>> lm.solve(problem, lm.ROMP()).coefficients.shape
    (16, 4096)
    """

    sparsity: int | None = None
    fidelity: Fidelity | str = Fidelity.REJECTION
    max_iterations: int | None = None
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", Fidelity(self.fidelity))
        if not Fidelity(self.fidelity).term.least_squares:
            raise SolverError(
                f"ROMP cannot use the fidelity {self.fidelity}, as it solves least squares",
                hint="use linear or rejection, or the solver saturation-admm",
            )
        check_at_least_one(sparsity=self.sparsity, max_iterations=self.max_iterations)

    def solve(self, problem: problems.Problem, progress: Progress | None = None) -> problems.Result:
        """Solve all rows, in chunks whose columns take up to `CHUNK_BYTES`."""
        n = self.sparsity or max(1, min(32, problem.patterns.count // 8))
        n = min(n, problem.patterns.pixels)
        size = max(1, problems.CHUNK_BYTES // (8 * 3 * n * problem.patterns.count))
        parts = []
        for start in range(0, problem.rows, size):
            rows = np.arange(start, min(start + size, problem.rows))
            parts.append(self._solve_chunk(problem.take(rows), n))
            if progress is not None:
                progress(int(rows[-1]) + 1, problem.rows)
        if not parts:
            return problems.Result(problems.no_rows(problem), problems.Status.CONVERGED)
        dtype = problem.samples.values.dtype
        solved = SparseRows.joined(parts)
        coefficients = csr_array(solved.coefficients, dtype=dtype)
        background = solved.background.astype(dtype)
        reached = problems.objective(problem, coefficients, background[:, 0], self.fidelity)
        solved = problems.solved_rows(
            coefficients, background, **solved.diagnostics, objective=reached
        )
        converged = solved.diagnostics["converged"].all()
        return problems.Result(
            solved, problems.Status.CONVERGED if converged else problems.Status.ITERATION_LIMIT
        )

    def row_bytes(self, patterns: int, pixels: int) -> int:
        """Bytes of one row: correlations, samples and the Gram matrix of up to 96 pixels."""
        return 8 * (3 * pixels + 8 * patterns + 96 * 96)

    def _solve_chunk(self, problem: problems.Problem, n: int) -> SparseRows:
        """The rows of a chunk, with the number of rounds and convergence as diagnostics."""
        rows = problem.rows
        observed = problem.observed.astype(np.float64)
        weights = np.where(Fidelity(self.fidelity).term.used(observed), observed.weights, 0)
        y = observed.values
        support = _Support.empty(rows)
        x, b = np.zeros((rows, 0)), np.zeros(rows)
        least = _LeastSquares(problem, y, weights)
        if problem.background:
            x, b = least.solve(support)
        residual = least.residual(support, x, b)
        norm = np.sqrt((weights * y**2).sum(axis=1))
        rounds = np.zeros(rows, np.int32)
        active = norm > 0
        for _ in range(self.max_iterations or n):
            active &= np.sqrt((weights * residual**2).sum(axis=1)) > self.tolerance * norm
            active &= support.count < 2 * n
            if not active.any():
                break
            correlations = problem.patterns.adjoint(weights * residual)
            chosen = _select(correlations, n, problem.nonnegative)
            before = support.count
            support = support.joined(chosen, active)
            # A round that adds no pixel would repeat itself.
            active &= support.count > before
            rounds += active
            x, b = least.solve(support)
            residual = least.residual(support, x, b)
        if problem.nonnegative:
            # Pixels with negative coefficients are removed until none is left.
            for _ in range(int(support.count.max(initial=0))):
                negative = support.used & (x < 0)
                if not negative.any():
                    break
                support = support.without(negative)
                x, b = least.solve(support)
            x, b = np.maximum(x, 0), np.maximum(b, 0)
        residual = least.residual(support, x, b)
        explained = np.sqrt((weights * residual**2).sum(axis=1)) <= self.tolerance * norm
        diagnostics = {"iterations": rounds, "converged": explained | ~active}
        return SparseRows(support.matrix(x, problem.patterns.pixels), b[:, None], diagnostics)


@dataclass(frozen=True)
class _Support:
    """The chosen pixels of each row, (rows, width), padded with -1 at the end."""

    index: NDArray[np.int64]

    @classmethod
    def empty(cls, rows: int) -> "_Support":
        return cls(np.full((rows, 0), -1, np.int64))

    @property
    def used(self) -> NDArray[np.bool_]:
        return self.index >= 0

    @property
    def count(self) -> NDArray[np.int64]:
        return self.used.sum(axis=1)

    def joined(self, chosen: NDArray[np.int64], rows: NDArray[np.bool_]) -> "_Support":
        """The support with the chosen pixels (-1 for none) added to some rows, each pixel once."""
        both = np.concatenate([self.index, np.where(rows[:, None], chosen, -1)], axis=1)
        both = -np.sort(-both, axis=1)
        both[:, 1:][both[:, 1:] == both[:, :-1]] = -1
        return _Support(_trimmed(both))

    def without(self, dropped: NDArray[np.bool_]) -> "_Support":
        return _Support(_trimmed(np.where(dropped, -1, self.index)))

    def matrix(self, x: NDArray[np.float64], pixels: int) -> csr_array:
        """Coefficients (rows, width) as sparse rows."""
        row, place = np.nonzero(self.used)
        entries = (x[row, place], (row, self.index[row, place]))
        return csr_array(entries, shape=(len(self.index), pixels))


def _trimmed(index: NDArray[np.int64]) -> NDArray[np.int64]:
    index = -np.sort(-index, axis=1)
    width = int((index >= 0).sum(axis=1).max(initial=0))
    return index[:, :width]


@dataclass(frozen=True)
class _LeastSquares:
    """Weighted least squares of each row on its support and the background."""

    problem: problems.Problem
    y: NDArray[np.float64]
    weights: NDArray[np.float64]

    def columns(self, support: _Support) -> NDArray[np.float64]:
        """The columns of each row's support, (rows, K, width), 0 where padded."""
        unique, place = np.unique(support.index, return_inverse=True)
        columns = self.problem.patterns.columns(np.maximum(unique, 0)).astype(np.float64)
        columns[:, unique < 0] = 0
        gathered = columns[:, place.reshape(support.index.shape)]
        return np.ascontiguousarray(np.moveaxis(gathered, 0, 1))

    def solve(self, support: _Support) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        columns = self.columns(support)
        background = self.problem.background
        if background:
            column = np.broadcast_to(self.problem.column[:, None], (*self.y.shape, 1))
            columns = np.concatenate([columns, column], axis=2)
        weighted = columns * self.weights[:, :, None]
        gram = np.matmul(weighted.transpose(0, 2, 1), columns)
        right = np.matmul(weighted.transpose(0, 2, 1), self.y[:, :, None])
        diagonal = np.einsum("rii->ri", gram)
        # Padding and columns without light get a 1, so that their coefficient is 0.
        # Ridge of the least squares, relative to the largest diagonal element. It makes the system
        # regular if columns are equal, and is far below any noise.
        diagonal += np.where(diagonal > 0, 1e-10 * diagonal.max(axis=1, keepdims=True), 1)
        x = np.linalg.solve(gram, right)[..., 0]
        return (x[:, :-1], x[:, -1]) if background else (x, np.zeros(len(x)))

    def residual(
        self, support: _Support, x: NDArray[np.float64], b: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        predicted = np.matmul(self.columns(support), x[:, :, None])[..., 0]
        if not self.problem.background:
            return self.y - predicted
        return self.y - predicted - np.outer(b, self.problem.column)


def _select(correlations: NDArray[np.float64], n: int, nonnegative: bool) -> NDArray[np.int64]:
    """The subset of comparable pixels with the greatest energy, of the n largest; -1 elsewhere."""
    size = np.maximum(correlations, 0) if nonnegative else np.abs(correlations)
    largest = np.argpartition(-size, n - 1, axis=1)[:, :n]
    values = np.take_along_axis(size, largest, axis=1)
    order = np.argsort(-values, axis=1, kind="stable")
    largest = np.take_along_axis(largest, order, axis=1)
    values = np.take_along_axis(values, order, axis=1)
    # A subset starts at some i and ends before the first value below half of values[i].
    inside = (2 * values[:, None, :] >= values[:, :, None]) & (values[:, None, :] > 0)
    inside &= np.arange(n)[None, None, :] >= np.arange(n)[None, :, None]
    energy = (inside * values[:, None, :] ** 2).sum(axis=2)
    best = energy.argmax(axis=1)
    return np.where(inside[np.arange(len(best)), best], largest, -1)
