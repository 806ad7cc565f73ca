"""The base class of the fidelities, and the samples as they see them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True, eq=False)
class Observed:
    """Samples and what a data term needs to know of each.

    Parameters
    ----------
    values : (M, K) float32 or float64
        y: linear samples; where clipped, a lower bound.
    clipped : (M, K) bool
        Whether the sample is clipped.
    clip_level : (M, K), dtype of the values
        Y: the value at which the sample clips.
    weights : (M, K), dtype of the values
        w >= 0; 0 masks a sample.
    edge : (M, K), dtype of the values
        s > 0: the width of the edge at the clip level (for ``likelihood``).
    """

    values: NDArray[Any]
    clipped: NDArray[np.bool_]
    clip_level: NDArray[Any]
    weights: NDArray[Any]
    edge: NDArray[Any]

    def astype(self, dtype: DTypeLike) -> Observed:
        """The same samples with numbers of another type."""
        numbers = (self.values, self.clip_level, self.weights, self.edge)
        values, clip_level, weights, edge = (part.astype(dtype) for part in numbers)
        return Observed(values, self.clipped, clip_level, weights, edge)

    def at(self, index: Any) -> Observed:
        """Some of the samples."""
        return Observed(*(getattr(self, field.name)[index] for field in fields(self)))


class DataTerm(ABC):
    """How one sample y is compared with its prediction u: a function f of u and its relatives.

    Methods work element by element on arrays u, v or t of the samples' shape. Unless they say so,
    they leave out the weight w of a sample.
    """

    # The name for users and for the compiled core.
    name: ClassVar[str]
    # Whether f is convex in u.
    convex: ClassVar[bool] = True
    # Whether the conjugate is t^2 / 2 wherever it is finite, so that exact steps are possible.
    quadratic: ClassVar[bool] = True
    # Whether f treats clipped samples differently from others.
    clip_aware: ClassVar[bool] = True
    # Whether f is least squares in the samples that it uses.
    least_squares: ClassVar[bool] = False

    @abstractmethod
    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        """f(u)."""

    @abstractmethod
    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        """-f'(u). Times w it is the sample's entry of the dual point."""

    @abstractmethod
    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        """The u-update: argmin over u of w f(u) + coupling (v - u)^2 / 2, in the dtype of v.

        Parameters
        ----------
        v : (M, K)
            A x + g / nu.
        observed : Observed
        coupling : float
            lambda times nu, > 0.
        """

    @abstractmethod
    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        """Maximum over u of t (y - u) - f(u), infinite where it is unbounded.

        The dual value of a point theta is the sum of y theta - w conjugate(theta / w).
        """

    def used(self, observed: Observed) -> NDArray[np.bool_]:
        """Which samples the data term uses."""
        return np.ones(observed.values.shape, bool)

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        """Which samples' dual variables may have either sign."""
        return np.ones(observed.values.shape, bool)


def quadratic_update(v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
    """The u-update of (y - u)^2 / 2, from w (y - u) = coupling (u - v)."""
    weighted = observed.weights * observed.values + coupling * v
    return weighted / (observed.weights + coupling)
