"""What a solver may ask of a fidelity: the small class that each of them is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True, eq=False)
class Observed:
    """Samples as a data term sees them: arrays of one shape, with one entry a sample.

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
        s > 0: how wide the edge at the clip level is (for ``likelihood``).
    """

    values: NDArray[Any]
    clipped: NDArray[np.bool_]
    clip_level: NDArray[Any]
    weights: NDArray[Any]
    edge: NDArray[Any]

    def astype(self, dtype: DTypeLike) -> Observed:
        """The same with numbers of another type."""
        numbers = (self.values, self.clip_level, self.weights, self.edge)
        values, clip_level, weights, edge = (part.astype(dtype) for part in numbers)
        return Observed(values, self.clipped, clip_level, weights, edge)

    def at(self, index: Any) -> Observed:
        """Some of the samples."""
        return Observed(*(getattr(self, one.name)[index] for one in fields(self)))


class DataTerm(ABC):
    """How one sample y is compared with its prediction u: a function f of u, and what follows.

    Methods work element by element, on arrays u, v or t of the samples' shape, and leave out the
    weight w of a sample unless they say otherwise.
    """

    # As users and the compiled core call it.
    name: ClassVar[str]
    # Whether f is convex in u.
    convex: ClassVar[bool] = True
    # Whether the conjugate is t^2 / 2 wherever it is finite, so that exact steps are possible.
    quadratic: ClassVar[bool] = True
    # Whether a clipped sample is known to be a lower bound, or less.
    clip_aware: ClassVar[bool] = True
    # Whether it is a least-squares problem in the samples that count.
    least_squares: ClassVar[bool] = False

    @abstractmethod
    def value(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        """f(u)."""

    @abstractmethod
    def residual(self, u: NDArray[Any], seen: Observed) -> NDArray[Any]:
        """-f'(u): times w, what the sample asks of the dual point."""

    @abstractmethod
    def update(self, v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
        """The u-update: argmin over u of w f(u) + coupling (v - u)^2 / 2, in the dtype of v.

        Parameters
        ----------
        v : (M, K)
            A x + g / nu.
        seen : Observed
        coupling : float
            lambda times nu, > 0.
        """

    @abstractmethod
    def conjugate(self, t: NDArray[Any], seen: Observed) -> NDArray[Any]:
        """Maximum over u of t (y - u) - f(u), infinite where there is none.

        The dual value of a point theta is the sum of y theta - w conjugate(theta / w).
        """

    def counted(self, seen: Observed) -> NDArray[np.bool_]:
        """Which samples say anything about the prediction."""
        return np.ones(seen.values.shape, bool)

    def free(self, seen: Observed) -> NDArray[np.bool_]:
        """Which samples' dual variables may take either sign."""
        return np.ones(seen.values.shape, bool)


def met(v: NDArray[Any], seen: Observed, coupling: float) -> NDArray[Any]:
    """The u-update of (y - u)^2 / 2, where w (y - u) = coupling (u - v)."""
    return (seen.weights * seen.values + coupling * v) / (seen.weights + coupling)
