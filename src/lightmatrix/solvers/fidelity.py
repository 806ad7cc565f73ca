"""Fidelities: how samples are compared with predictions. Each is a `DataTerm` with a name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.special import erfcx, log_ndtr

from lightmatrix.errors import InputError, SolverError


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

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return t**2 / 2


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

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped & (t < 0), np.inf, t**2 / 2)

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


class Rejection(Linear):
    """f(u) = (y - u)^2 / 2, and 0 for clipped samples (Laska et al. 2009)."""

    name = "rejection"
    clip_aware = True

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped, 0, observed.values - u)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        return np.where(observed.clipped, v, quadratic_update(v, observed, coupling))

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        return np.where(observed.clipped & (t != 0), np.inf, t**2 / 2)

    def used(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


class Clipped(DataTerm):
    """f(u) = (y - min(u, Y))^2 / 2, where Y = y for clipped samples; convex only if y = Y."""

    name = "clipped"
    convex = False
    quadratic = False

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

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        raise SolverError(
            "the fidelity clipped is not convex, so there is no dual value",
            hint="use one-sided, its convex part",
        )


def _level(observed: Observed) -> NDArray[Any]:
    """The prediction from which a sample counts as clipped: its own value, a lower bound."""
    above = np.maximum(observed.clip_level, observed.values)
    return np.where(observed.clipped, observed.values, above)


# Limit of Newton steps. They converge quadratically, so that a handful are enough.
_NEWTON_STEPS = 100


class Likelihood(DataTerm):
    """f(u) = (y - u)^2 / 2, or -s^2 log Phi((u - y) / s) if clipped; `OneSided` as s goes to 0."""

    name = "likelihood"
    quadratic = False

    def value(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        difference = observed.values - u
        cost = -(observed.edge**2) * log_ndtr(-difference / observed.edge)
        return np.where(observed.clipped, cost, difference**2 / 2)

    def residual(self, u: NDArray[Any], observed: Observed) -> NDArray[Any]:
        slope = observed.edge * mills((u - observed.values) / observed.edge)
        return np.where(observed.clipped, slope, observed.values - u)

    def update(self, v: NDArray[Any], observed: Observed, coupling: float) -> NDArray[Any]:
        u = quadratic_update(v, observed, coupling)
        at = np.nonzero(observed.clipped)
        clipped = observed.at(at)
        u[at] = edge_update(v[at], clipped.values, clipped.weights, coupling, clipped.edge)
        return u

    def conjugate(self, t: NDArray[Any], observed: Observed) -> NDArray[Any]:
        cost = t**2 / 2
        at = np.nonzero(observed.clipped)
        edge = observed.edge[at]
        # Predictions above the clip level cost nothing, so for t < 0 there is no maximum.
        cost[at] = np.where(t[at] < 0, np.inf, edge**2 * _edge_conjugate(t[at] / edge))
        return cost

    def two_sided(self, observed: Observed) -> NDArray[np.bool_]:
        return ~observed.clipped


def mills(z: NDArray[Any]) -> NDArray[np.float64]:
    """phi(z) / Phi(z), minus the slope of -log Phi: about -z far below 0, about 0 far above."""
    return np.asarray(np.sqrt(2 / np.pi) / erfcx(np.asarray(z, np.float64) / -np.sqrt(2)))


def edge_update(
    v: NDArray[Any],
    y: NDArray[Any],
    weights: NDArray[Any],
    coupling: float,
    width: NDArray[Any],
) -> NDArray[Any]:
    """argmin_u -w s^2 log Phi((u - y) / s) + coupling (v - u)^2 / 2, element by element.

    With z = (u - y) / s, the slope over s is coupling (z - z_v) - w mills(z). It increases and is
    concave in z, since the Mills ratio is convex, so Newton's steps from below the root rise to it
    and never pass it. They start at the root for max(0, -z) <= mills(z), the one-sided solution.
    """
    ratio = np.asarray(weights, np.float64) / coupling
    target = (np.asarray(v, np.float64) - y) / width
    z = np.where(target > 0, target, target / (1 + ratio))
    for _ in range(_NEWTON_STEPS):
        slope = mills(z)
        step = (target - z + ratio * slope) / (1 + ratio * slope * np.maximum(z + slope, 0))
        z = z + step
        if _converged(step, z):
            break
    return np.asarray(y + width * z, v.dtype)


def _edge_conjugate(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maximum over z of log Phi(z) - t z for t >= 0, which lies at mills(z) = t.

    log mills is concave and decreasing, so Newton's steps from the right of the root stay there.
    """
    t = np.maximum(t, 0)
    target = np.log(np.maximum(t, np.finfo(np.float64).tiny))
    # mills(z) <= exp(-z^2 / 2) for z >= 0 and <= 1 - z for z <= 0, so the start lies right of the
    # root.
    z = np.where(target < 0, np.sqrt(np.maximum(-2 * target, 0)), 1 - t)
    for _ in range(_NEWTON_STEPS):
        # log mills(z), in a form that neither underflows nor cancels.
        right = -(z**2 + np.log(2 * np.pi)) / 2 - log_ndtr(z)
        logarithm = np.where(z > 0, right, np.log(mills(np.minimum(z, 0))))
        step = (logarithm - target) / (z + mills(z))
        z = z + step
        if _converged(step, z):
            break
    return np.asarray(np.where(t > 0, log_ndtr(z) - t * z, 0))


def _converged(step: NDArray[np.float64], z: NDArray[np.float64]) -> bool:
    # Newton's method stops at steps below this, relative to 1 + |z|: some thousand times the
    # rounding.
    return bool((np.abs(step) <= 1e-12 * (1 + np.abs(z))).all())


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

    ``clipped`` is the paper's Eq. 6, ``one-sided`` comes from Rencker et al. 2018 (declipping) and
    ``rejection`` from Laska et al. 2009. ``likelihood`` is the probability that a sample with noise
    of standard deviation s clips (Banerjee et al. 2021): its negative logarithm, in the unit of (y
    - u)^2 / 2, with Phi the normal distribution function. As s goes to 0 it becomes ``one-sided``.

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
    LIKELIHOOD = "likelihood"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise InputError(
            f"a fidelity called {value!r}", hint=f"use one of {', '.join(sorted(cls))}"
        )

    @property
    def term(self) -> DataTerm:
        """The data term of this name."""
        return _TERMS[self]

    @property
    def convex(self) -> bool:
        """Whether the data term is convex in the prediction."""
        return self.term.convex


_TERMS = {
    Fidelity(term.name): term
    for term in (Linear(), OneSided(), Clipped(), Rejection(), Likelihood())
}
