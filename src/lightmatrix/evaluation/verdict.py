"""`lm.verdict`: how far to trust an estimate, judged by the diagnostics of its rows."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lightmatrix.evaluation.doubts import OwnError
from lightmatrix.evaluation.metrics import unclipped_rows
from lightmatrix.transport.matrix import LightTransport

Level = Literal["good", "fair", "doubtful", "not tested"]

# An estimate is called good up to the first relative error of T, and fair up to the second. Both
# were chosen by hand; no measurement stands behind them.
GOOD, FAIR = 0.05, 0.2
# If the single responses of more than the first share of the rows clip, no estimate is called good;
# if more than the second share does, the verdict mentions it. Neither the estimated error nor
# unseen photographs show the light beyond the clip level. Chosen by hand: such rows are bright, so
# few of them matter.
SINGLY_CLIPPED, _SOME_CLIPPED = 0.02, 0.002
# The verdict mentions it if more than this share of the rows clip in half of their samples, or do
# not converge. Chosen by hand.
_MANY_CLIPPED, _MANY_UNFINISHED = 0.1, 0.01
# Kinds of findings of `check` that spoil T where neither estimated errors nor unseen photographs
# show it: these photographs are wrong alike.
_SPOILING = ("order", "unrelated", "response", "projector", "motion", "patterns")
# The sentence that states an error, which such a finding makes void.
_STATED = re.compile(r"Estimated error of T: [^%]*%\. ?")
_UNTESTED = "It was not tested on unseen photographs (`estimate --report` does that)."
_REMEDY = (
    "More patterns help most, then an exposure that uses the camera's range, or binned projector "
    "pixels. Neighbouring camera pixels must see neighbouring projector pixels."
)


@dataclass(frozen=True)
class Verdict:
    """How far to trust an estimate.

    Parameters
    ----------
    level : {"good", "fair", "doubtful", "not tested"}
        The verdict in a word.
    sentence : str
        The reasons with their numbers, in short sentences.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> print(lm.Verdict("good", "Prediction error on unseen photographs: 1 %."))
    Good. Prediction error on unseen photographs: 1 %.
    """

    level: Level
    sentence: str

    def __str__(self) -> str:
        return f"{self.level.capitalize()}. {self.sentence}"

    def with_findings(self, kinds: Iterable[str]) -> Verdict:
        """The verdict, doubtful if `check` found what spoils T unnoticed.

        Parameters
        ----------
        kinds : iterable of str
            The kinds of the findings.
        """
        spoiling = sorted(set(kinds) & set(_SPOILING))
        if not spoiling:
            return self
        doubt = f"The check found what no error estimate shows ({', '.join(spoiling)})."
        level: Level = self.level if self.level == "not tested" else "doubtful"
        return Verdict(level, " ".join([_STATED.sub("", self.sentence), doubt]).strip())


def verdict(transport: LightTransport, why_untested: str = _UNTESTED) -> Verdict:
    """Judge an estimate by the errors that it estimates of its own rows.

    Parameters
    ----------
    transport : LightTransport
        An estimate. A matrix without diagnostics cannot be judged.
    why_untested : str
        The sentence to add where no row has an estimated error.

    Returns
    -------
    Verdict
        "not tested" where no row has an estimated error, and nothing makes it doubtful. A solver
        that converged certifies that it solved its problem, not that the solution is T. Doubtful if
        `check` found in the capture what no error estimate shows; the provenance of an estimate
        holds its findings.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> print(lm.verdict(lm.truth("metal").transport()))
    Not tested. The matrix has no diagnostics.
    """
    judged = verdict_by_rows(transport, why_untested)
    return judged.with_findings(stored_findings(transport))


def stored_findings(transport: LightTransport) -> tuple[str, ...]:
    """The kinds of the findings that the provenance holds; none if it holds anything else."""
    kept = transport.provenance.get("findings")
    if not isinstance(kept, (list, tuple)):
        return ()
    kinds = (each.get("kind") for each in kept if isinstance(each, Mapping))
    return tuple(kind for kind in kinds if isinstance(kind, str))


def verdict_by_rows(transport: LightTransport, why_untested: str = _UNTESTED) -> Verdict:
    """The verdict by the diagnostics of the rows alone, whatever was found in the capture."""
    if not transport.diagnostics:
        return Verdict("not tested", "The matrix has no diagnostics.")
    remarks, own = _remarks(transport), OwnError(transport)
    if own.estimated is None:
        level: Level = "doubtful" if own.doubts else "not tested"
        return Verdict(level, " ".join([*own.doubts, *remarks, why_untested]))
    error = own.stated
    if error is None:
        reasons = ["The error of T is not known.", *own.doubts]
        return Verdict("doubtful", " ".join([*reasons, *remarks]))
    clipped = singly_clipped(transport, _shortest_exposure(transport))
    level, warnings = limited(level_of(error), clipped)
    if level == "doubtful":
        remarks.append(_REMEDY)
    sentences = [f"Estimated error of T: {percent(error)}.", *warnings, *remarks]
    return Verdict(level, " ".join(sentences))


def singly_clipped(transport: LightTransport, exposure: float) -> float:
    """Share of the rows whose strongest single response clips at an exposure."""
    return 1 - float(np.mean(unclipped_rows(transport, exposure)))


def limited(level: Level, clipped: float) -> tuple[Level, list[str]]:
    """A level, lowered if the single responses of too many rows clip, and warnings about it."""
    if clipped <= _SOME_CLIPPED:
        return level, []
    if level == "good" and clipped > SINGLY_CLIPPED:
        level = "fair"
    return level, [
        f"But {percent(clipped)} of the rows clip under a single projector pixel, and no "
        "photograph shows by how much."
    ]


def _shortest_exposure(transport: LightTransport) -> float:
    """The shortest exposure by the provenance; 0, at which nothing clips, if it is unknown."""
    description = transport.provenance.get("capture_description")
    # The provenance of a store may hold anything.
    try:
        exposure = (
            float(np.min(description["exposure"])) if isinstance(description, Mapping) else 0.0
        )
    except (TypeError, ValueError, KeyError):
        return 0.0
    return exposure if np.isfinite(exposure) else 0.0


def level_of(error: float) -> Level:
    """The verdict on a relative error of T."""
    return "good" if error <= GOOD else "fair" if error <= FAIR else "doubtful"


def _remarks(transport: LightTransport) -> list[str]:
    """Sentences about convergence and clipping."""
    remarks = []
    diagnostics = transport.diagnostics
    finished = float(np.mean(diagnostics.get("converged", np.ones(1))))
    if 1 - finished > _MANY_UNFINISHED:
        remarks.append(f"{percent(1 - finished)} of the rows reached the iteration limit.")
    elif "converged" in diagnostics:
        remarks.append(f"{percent(finished)} of the rows converged.")
    clipped = np.asarray(diagnostics.get("clipped_share", np.zeros(1)))
    often = float(np.mean(clipped > 0.5))
    if often > _MANY_CLIPPED:
        remarks.append(f"{percent(often)} of the rows clipped in more than half of their samples.")
    return remarks


def percent(share: float) -> str:
    """A share in per cent, rounded to two digits or to whole per cent."""
    value = 100 * share
    digits = "0" if value == 0 else f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"
    return f"{digits} %"
