"""Fidelities: how samples are compared with predictions. Each is a `DataTerm` with a name."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lightmatrix.errors import InputError


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

    def astype(self, dtype: DTypeLike) -> "Observed":
        """The same samples with numbers of another type."""
        numbers = (self.values, self.clip_level, self.weights)
        values, clip_level, weights = (part.astype(dtype) for part in numbers)
        return Observed(values, self.clipped, clip_level, weights)

    def at(self, index: Any) -> "Observed":
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

    def used(self, observed: Observed) -> NDArray[np.bool_]:
        """Which samples the data term uses."""
        return np.ones(observed.values.shape, bool)


def quadratic_update(v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
    """The u-update of (y - u)^2 / 2, from w (y - u) = coupling (u - v)."""
    weighted = observed.weights * observed.values + coupling * v
    return weighted / (observed.weights + coupling)


class Linear(DataTerm):
    """f(u) = (y - u)^2 / 2, also for clipped samples (the paper's Eq. 2)."""

    name = "linear"
    clip_aware = False
    least_squares = True

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return self.residual(u, observed) ** 2 / 2

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return observed.values - u

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        return quadratic_update(v, observed, coupling)


class OneSided(Linear):
    """f(u) = (y - u)^2 / 2, and max(0, y - u)^2 / 2 for clipped samples (Rencker et al. 2018)."""

    name = "one-sided"
    clip_aware = True
    least_squares = False

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        difference = observed.values - u
        return np.where(observed.clipped, np.maximum(difference, 0), difference)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        satisfied = observed.clipped & (v > observed.values)
        return np.where(satisfied, v, quadratic_update(v, observed, coupling))


class Rejection(Linear):
    """f(u) = (y - u)^2 / 2, and 0 for clipped samples (Laska et al. 2009)."""

    name = "rejection"
    clip_aware = True

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped, 0, observed.values - u)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        return np.where(observed.clipped, v, quadratic_update(v, observed, coupling))

    def used(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


class Clipped(DataTerm):
    """f(u) = (y - min(u, Y))^2 / 2, where Y = y for clipped samples; convex only if y = Y."""

    name = "clipped"
    convex = False

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return (observed.values - np.minimum(u, _level(observed))) ** 2 / 2

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(u < _level(observed), observed.values - u, 0)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        # Eq. 20-21: beyond a threshold, leaving the prediction clipped at u = v costs less. With a
        # weight w, 1 / (lambda nu) of Eq. 19 becomes w / (lambda nu) = w / c, and the threshold is
        # y + sqrt(1 + w / c) (Y - y).
        y = observed.values
        with np.errstate(divide="ignore"):
            factor = np.sqrt(1 + observed.weights / coupling)
        clipped = v > y + factor * (_level(observed) - y)
        return np.where(clipped, v, quadratic_update(v, observed, coupling))


def _level(observed: Observed) -> NDArray[Any]:
    """The prediction from which a sample counts as clipped: its own value, a lower bound."""
    above = np.maximum(observed.clip_level, observed.values)
    return np.where(observed.clipped, observed.values, above)


class Fidelity(StrEnum):
    """How a sample y is compared with the prediction u (Y is the clip level).

    ========== ===================================== ============================ =======
    name       unclipped samples                     clipped samples              convex
    ========== ===================================== ============================ =======
    linear     (y - u)^2 / 2                         (y - u)^2 / 2                yes
    one-sided  (y - u)^2 / 2                         max(0, y - u)^2 / 2          yes
    clipped    (y - min(u, Y))^2 / 2                 the same; convex at y = Y    no
    rejection  (y - u)^2 / 2                         nothing                      yes
    ========== ===================================== ============================ =======

    ``clipped`` is the paper's Eq. 6, ``one-sided`` comes from Rencker et al. 2018 (declipping) and
    ``rejection`` from Laska et al. 2009.

    Every fidelity may be given by its name: ``ActiveSet(fidelity="linear")``.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.Fidelity("rejection").convex, lm.Fidelity.CLIPPED.convex
    (True, False)
    """

    LINEAR = "linear"
    ONE_SIDED = "one-sided"
    CLIPPED = "clipped"
    REJECTION = "rejection"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        hint = f"use one of {', '.join(sorted(cls))}"
        raise InputError(f"a fidelity called {value!r}", hint=hint)

    @property
    def term(self) -> DataTerm:
        """The data term of this name."""
        return _TERMS[self]

    @property
    def convex(self) -> bool:
        """Whether the data term is convex in the prediction."""
        return self.term.convex


_TERMS = {Fidelity(term.name): term for term in (Linear(), OneSided(), Clipped(), Rejection())}
