"""The names of the fidelities."""

from __future__ import annotations

from enum import StrEnum
from typing import NoReturn

from lightmatrix.errors import InputError
from lightmatrix.solvers.fidelity.clipped import Clipped
from lightmatrix.solvers.fidelity.data_term import DataTerm
from lightmatrix.solvers.fidelity.likelihood import Likelihood
from lightmatrix.solvers.fidelity.quadratic import Linear, OneSided, Rejection


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
