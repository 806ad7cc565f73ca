"""What to think of an estimate, in plain words, from what its rows know of themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lightmatrix.evaluation.metrics import row_energies, unclipped_rows
from lightmatrix.transport.matrix import LightTransport

Level = Literal["good", "fair", "doubtful", "not tested"]

# Relative errors up to which an estimate is called good, and fair.
GOOD, FAIR = 0.05, 0.2
_UNTESTED = (
    "it was not held against photographs that it has not seen (`estimate --report` does that)"
)
_REMEDY = (
    "more patterns help most, then an exposure that uses the camera's range, or projector pixels "
    "binned together; neighbouring camera pixels must see neighbouring projector pixels"
)
# Of the rows: with more whose single responses clip no estimate is called good; fewer are worth a
# word, as they are bright. What they state of their errors, and photographs held out, know nothing
# of the light beyond the clip level.
SINGLY_CLIPPED, _SOME_CLIPPED = 0.02, 0.002
# Of the rows: more that clip in half of their samples, or did not converge, are worth a word.
_MANY_CLIPPED, _MANY_UNFINISHED = 0.1, 0.01


@dataclass(frozen=True)
class Verdict:
    """What to think of an estimate.

    Parameters
    ----------
    level : {"good", "fair", "doubtful", "not tested"}
        In a word.
    sentence : str
        Why, in one sentence with numbers.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> print(lm.Verdict("good", "photographs held out are met within 1 %"))
    good: photographs held out are met within 1 %
    """

    level: Level
    sentence: str

    def __str__(self) -> str:
        return f"{self.level}: {self.sentence}"


def verdict(transport: LightTransport, why_untested: str = _UNTESTED) -> Verdict:
    """Judge an estimate by the errors that it states of its rows, or by what else is known.

    Parameters
    ----------
    transport : LightTransport
        An estimate; a matrix without diagnostics cannot be judged.
    why_untested : str
        What is said where rows state no error.

    Returns
    -------
    Verdict
        "not tested" where no row states its error: solvers that converge certify that they solved
        their problem, not that its solution is T.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> print(lm.verdict(lm.truth("metal").transport()))
    not tested: the matrix knows nothing of how it was found
    """
    diagnostics = transport.diagnostics
    if not diagnostics:
        return Verdict("not tested", "the matrix knows nothing of how it was found")
    remarks = _remarks(transport)
    stated = stated_error(transport)
    if stated is None:
        return Verdict("not tested", "; ".join([*remarks, why_untested]))
    said = f"the rows state a relative error of T of {percent(stated)}"
    level, unseen = limited(level_of(stated), singly_clipped(transport, _shortest(transport)))
    if level == "doubtful":
        remarks.append(_REMEDY)
    return Verdict(level, "; ".join([said, *unseen, *remarks]))


def singly_clipped(transport: LightTransport, exposure: float) -> float:
    """Share of the rows whose strongest single response clips at an exposure, the shortest."""
    return 1 - float(np.mean(unclipped_rows(transport, exposure)))


def limited(level: Level, clipped: float) -> tuple[Level, list[str]]:
    """A level that does not trust in light that nobody saw, and what to say of it.

    Parameters
    ----------
    level : {"good", "fair", "doubtful"}
        By what rows state and photographs say, which know nothing of it.
    clipped : float
        Share of the rows whose single responses clip.
    """
    if clipped <= _SOME_CLIPPED:
        return level, []
    told = f"but {percent(clipped)} of the rows clip under a single projector pixel, and nobody "
    if level == "good" and clipped > SINGLY_CLIPPED:
        level = "fair"
    return level, [told + "saw by how much"]


def _shortest(transport: LightTransport) -> float:
    """Its shortest exposure by its provenance; 0, at which nothing clips, if that has none."""
    told = transport.provenance.get("capture_description")
    # A store may say anything.
    try:
        exposure = float(np.min(told["exposure"])) if isinstance(told, Mapping) else 0.0
    except (TypeError, ValueError, KeyError):
        return 0.0
    return exposure if np.isfinite(exposure) else 0.0


def stated_error(transport: LightTransport) -> float | None:
    """The relative error of T that follows from those that its rows state of themselves.

    Returns
    -------
    float or None
        ||error of T|| / ||T|| in the Frobenius norm, over the rows that state theirs; None where
        there are none.
    """
    errors = np.asarray(transport.diagnostics.get("estimated_error", np.zeros(0)), float)
    known = np.flatnonzero(np.isfinite(errors))
    if not known.size:
        return None
    energy = row_energies(transport)[known]
    total = float(energy.sum())
    wrong = float((energy * errors[known] ** 2).sum())
    return float(np.sqrt(wrong / total)) if total else float(np.median(errors[known]))


def level_of(error: float) -> Level:
    """The word for a relative error."""
    return "good" if error <= GOOD else "fair" if error <= FAIR else "doubtful"


def _remarks(transport: LightTransport) -> list[str]:
    """What is unusual about the rows; that all is well, if nothing is."""
    told = []
    diagnostics = transport.diagnostics
    finished = float(np.mean(diagnostics.get("converged", np.ones(1))))
    if 1 - finished > _MANY_UNFINISHED:
        told.append(f"{percent(1 - finished)} of the rows reached the iteration limit")
    elif "converged" in diagnostics:
        told.append(f"{percent(finished)} of the rows converged")
    clipped = np.asarray(diagnostics.get("clipped_share", np.zeros(1)))
    often = float(np.mean(clipped > 0.5))
    if often > _MANY_CLIPPED:
        told.append(f"{percent(often)} of the rows clipped in more than half of their samples")
    return told


def percent(share: float) -> str:
    """A share in per cent, with as many digits as tell something."""
    value = 100 * share
    digits = "0" if value == 0 else f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"
    return f"{digits} %"
