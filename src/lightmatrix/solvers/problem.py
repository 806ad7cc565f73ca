"""What a solver is given and what it returns, batched over camera samples."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import short_repr


class Fidelity(StrEnum):
    """How a sample y is compared with the prediction u (Y is the clip level).

    ========== ===================================== ============================ =======
    name       unclipped samples                     clipped samples              convex
    ========== ===================================== ============================ =======
    linear     (y - u)^2 / 2                         (y - u)^2 / 2                yes
    one-sided  (y - u)^2 / 2                         max(0, y - u)^2 / 2          yes
    clipped    (y - min(u, Y))^2 / 2                 the same; convex at y = Y    no
    rejection  (y - u)^2 / 2                         nothing                      yes
    likelihood (y - u)^2 / 2                         -s^2 log Phi((u - y) / s)    yes
    ========== ===================================== ============================ =======

    ``clipped`` is the paper's Eq. 6, ``one-sided`` is Rencker et al. 2018 (declipping),
    ``rejection`` is Laska et al. 2009, ``likelihood`` is the probability that a sample with noise
    of standard deviation s clips (Banerjee et al. 2021), Phi the normal distribution function, in
    the unit in which (y - u)^2 / 2 is that of the others. For s to 0 it becomes ``one-sided``.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.ActiveSet(lm.Fidelity.REJECTION).fidelity.convex
    True
    """

    LINEAR = "linear"
    ONE_SIDED = "one-sided"
    CLIPPED = "clipped"
    REJECTION = "rejection"
    LIKELIHOOD = "likelihood"

    @property
    def convex(self) -> bool:
        """Whether the data term is convex in the prediction."""
        return self is not Fidelity.CLIPPED


class Status(StrEnum):
    """Why a row stopped; each is its own remedy."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached: raise the limit or the tolerance"
    NOT_FINITE = "left the finite numbers: check the samples, raise the regularization"


@dataclass(frozen=True)
class Problem:
    """Estimate M rows of the light transport matrix from K samples each.

    For each row: min_{x, b} regularization * ||x||_1 + sum_k w_k f_k(a_k . x + b m_k), with a_k
    pattern k, m_k its mean and f_k the solver's fidelity. This is the paper's Eq. 2 and 6 times
    lambda. With ``nonnegative``, x >= 0 and b >= 0; without ``background``, b = 0.

    Parameters
    ----------
    patterns : PatternSet
        K patterns over N projector pixels.
    samples : Samples
        Of M camera samples under K patterns: linear, black subtracted; where clipped, a lower
        bound. The `clipped` fidelity uses the clip level of unclipped samples too.
    regularization : float
        The paper's lambda, in units of camera sample; > 0.
    nonnegative : bool
        Light is not negative; off only where the paper is reproduced.
    background : bool
        Whether the row has an unpenalised coefficient b of the pattern means (diffuse light).
    edge_noise : float
        The s of the ``likelihood`` fidelity as a share of each sample's clip level, from 1e-4 to 1:
        how far below it the prediction of a clipped sample is likely. Noise and misfit together.

    Raises
    ------
    InputError
        On mismatched shapes, samples that are not finite, or values out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> lm.Problem(patterns, samples, regularization=0.01).rows
    1
    """

    patterns: PatternSet
    samples: Samples
    regularization: float
    nonnegative: bool = True
    background: bool = True
    edge_noise: float = 0.02

    __repr__ = short_repr

    def __post_init__(self) -> None:
        self.samples.check(self.patterns.count)
        if not (np.isfinite(self.regularization) and self.regularization > 0):
            raise InputError(
                f"regularization is {self.regularization}",
                hint="use a positive number in units of camera sample, such as 0.3",
            )
        if not 1e-4 <= self.edge_noise <= 1:
            raise InputError(
                f"edge_noise is {self.edge_noise}",
                hint="use a share of the clip level from 0.0001 to 1, such as 0.02",
            )

    @property
    def rows(self) -> int:
        """Number of camera samples M."""
        return self.samples.count

    def take(self, rows: NDArray[np.integer]) -> Problem:
        """The problem of some of the rows."""
        return replace(self, samples=self.samples.rows(rows))

    def edge_widths(self) -> NDArray[Any]:
        """The s of the ``likelihood`` fidelity, (M, K), in the dtype of the samples."""
        # A level of 0 (room light all over the range) leaves nothing to be wide.
        tiny = np.finfo(self.samples.values.dtype).tiny
        return np.maximum(
            self.edge_noise * np.abs(self.samples.clip_levels_of_all()), np.sqrt(tiny)
        )


@dataclass(frozen=True)
class Result:
    """What a solver found, row by row.

    Parameters
    ----------
    coefficients : (M, N) csr_array
        The sparse rows x, in units of camera sample per unit of projector pixel.
    background : (M,) float32 or float64
        The coefficient b of the pattern means; 0 where the problem has none.
    iterations : (M,) int32
        Iterations (ADMM), rounds (ROMP) or passes (active set) spent on each row.
    converged : (M,) bool
        Whether the row met its stopping rule.
    objective : (M,) float64
        The problem's objective in the solver's fidelity, recomputed from the definition.
    gap : (M,) float64
        Relative duality gap (P - D) / max(P, 1e-6 ||y||^2 / 2); NaN where none is computed or
        the fidelity is not convex.
    status : Status
        The worst over the rows.
    history : dict of str to list of float
        Per-iteration residuals or counts, for plots; empty if the solver keeps none.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((4, 4), 24)
    >>> lit = np.eye(16)[[5]]
    >>> values = patterns.forward(lit)
    >>> samples = lm.Samples(values, values > 2, np.full(24, 2.0))
    >>> result = lm.solve(lm.Problem(patterns, samples, regularization=0.01), lm.ActiveSet())
    >>> result.converged
    array([ True])
    """

    coefficients: csr_array
    background: NDArray[Any]
    iterations: NDArray[np.int32]
    converged: NDArray[np.bool_]
    objective: NDArray[np.float64]
    gap: NDArray[np.float64]
    status: Status
    history: dict[str, list[float]] = field(default_factory=dict)

    __repr__ = short_repr
