"""The base class of the fidelities, and the samples as they see them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True, eq=False)
class Observed:
    """Samples and what a data term needs of each, (M, K), all of one float type but `clipped`."""

    # y: linear samples; where clipped, a lower bound.
    values: NDArray[Any]
    clipped: NDArray[np.bool_]
    # Y: the value at which the sample clips.
    clip_level: NDArray[Any]
    # w >= 0; 0 masks a sample.
    weights: NDArray[Any]
    # s > 0: the width of the edge at the clip level (for `Likelihood`).
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
    """A function f of the prediction u of a sample y, and its relatives, element by element.

    Unless methods say so, they leave out the weight w of a sample.
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
        """The argmin over u of w f(u) + coupling (v - u)^2 / 2, with v = A x + g / nu."""

    @abstractmethod
    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        """The conjugate g(t): maximum over u of t (y - u) - f(u), infinite where unbounded."""

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
