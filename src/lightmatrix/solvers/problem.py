"""What a solver is given and what it returns, batched over camera samples."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.patterns import PatternSet


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
    samples : (M, K) float32 or float64
        Camera samples, linear, black subtracted; where clipped, a lower bound.
    clipped : (M, K) bool
        Which samples clipped.
    clip_level : (K,) or (M, K), same dtype as samples
        The level Y at which the camera clips (needed by the ``clipped`` fidelity, where the
        prediction of an unclipped sample is clipped too).
    regularization : float
        The paper's lambda, in units of camera sample; > 0.
    weights : (M, K) or (K,), optional
        Weight of each sample in the data term, >= 0; 0 masks it. None means 1.
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
    """

    patterns: PatternSet
    samples: NDArray[Any]
    clipped: NDArray[np.bool_]
    clip_level: NDArray[Any]
    regularization: float
    weights: NDArray[Any] | None = None
    nonnegative: bool = True
    background: bool = True
    edge_noise: float = 0.02

    def __post_init__(self) -> None:
        samples = self.samples
        if samples.ndim != 2 or samples.shape[1] != self.patterns.count:
            raise InputError(
                f"samples have shape {samples.shape}, but there are {self.patterns.count} patterns",
                hint="give samples as (camera samples, patterns)",
            )
        if samples.dtype not in (np.float32, np.float64):
            raise InputError(f"samples are {samples.dtype}", hint="convert them to float32")
        if self.clipped.shape != samples.shape or self.clipped.dtype != np.bool_:
            raise InputError(
                f"the clipped mask is {self.clipped.dtype} {self.clipped.shape}, "
                f"the samples are {samples.shape}",
                hint="give one boolean for each sample",
            )
        for name, value in (("clip_level", self.clip_level), ("weights", self.weights)):
            if value is not None and value.shape not in (samples.shape, samples.shape[1:]):
                raise InputError(
                    f"{name} has shape {value.shape}, the samples {samples.shape}",
                    hint=f"use {samples.shape[1:]} (one a pattern) or {samples.shape}",
                )
        if not np.isfinite(samples).all():
            row, frame = np.argwhere(~np.isfinite(samples))[0]
            raise InputError(
                f"the sample of camera row {row}, pattern {frame} is {samples[row, frame]}",
                hint="mask it with weight 0 and set its value to 0",
            )
        if not (np.isfinite(self.regularization) and self.regularization > 0):
            raise InputError(
                f"regularization is {self.regularization}",
                hint="use a positive number in units of camera sample, such as 0.3",
            )
        if self.weights is not None and not (
            np.isfinite(self.weights).all() and (self.weights >= 0).all()
        ):
            raise InputError("a weight is negative or not finite", hint="use 0 to mask a sample")
        if not 1e-4 <= self.edge_noise <= 1:
            raise InputError(
                f"edge_noise is {self.edge_noise}",
                hint="use a share of the clip level from 0.0001 to 1, such as 0.02",
            )

    @property
    def rows(self) -> int:
        """Number of camera samples M."""
        return int(self.samples.shape[0])

    def take(self, rows: NDArray[np.integer]) -> Problem:
        """The problem of some of the rows."""
        return replace(
            self,
            samples=self.samples[rows],
            clipped=self.clipped[rows],
            clip_level=_take(self.clip_level, rows),
            weights=None if self.weights is None else _take(self.weights, rows),
        )

    def sample_weights(self) -> NDArray[Any]:
        """Weights broadcast to (M, K), in the dtype of the samples."""
        if self.weights is None:
            return np.ones(self.samples.shape, self.samples.dtype)
        return np.broadcast_to(self.weights, self.samples.shape).astype(self.samples.dtype)

    def clip_levels(self) -> NDArray[Any]:
        """Clip levels broadcast to (M, K), in the dtype of the samples."""
        return np.broadcast_to(self.clip_level, self.samples.shape).astype(self.samples.dtype)

    def edge_widths(self) -> NDArray[Any]:
        """The s of the ``likelihood`` fidelity, (M, K), in the dtype of the samples."""
        # A level of 0 (room light all over the range) leaves nothing to be wide.
        tiny = np.finfo(self.samples.dtype).tiny
        return np.maximum(self.edge_noise * np.abs(self.clip_levels()), np.sqrt(tiny))


def _take(values: NDArray[Any], rows: NDArray[np.integer]) -> NDArray[Any]:
    """Rows of a (M, K) array; a (K,) array is shared by all rows."""
    return values[rows] if values.ndim == 2 else values


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
    """

    coefficients: csr_array
    background: NDArray[Any]
    iterations: NDArray[np.int32]
    converged: NDArray[np.bool_]
    objective: NDArray[np.float64]
    gap: NDArray[np.float64]
    status: Status
    history: dict[str, list[float]] = field(default_factory=dict)
