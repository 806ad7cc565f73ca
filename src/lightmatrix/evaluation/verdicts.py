"""`lm.verdicts`: an estimate judged by three questions, each by what bears on it.

Whether its map of correspondences is right, whether it relights scenes, and whether it is T are
different questions: stripes settle the first where they say nothing of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from lightmatrix.evaluation.verdict import (
    Level,
    Verdict,
    level_of,
    percent,
    stored_findings,
    verdict,
)
from lightmatrix.transport.matrix import LightTransport, prediction_error

# A correspondence is good if at least the first share of the lit camera pixels is certain of its
# strongest projector pixel, and fair from the second share on. Chosen by hand.
_CERTAIN_GOOD, _CERTAIN_FAIR = 0.95, 0.8
# A camera sample is lit if a white pattern gives it more than this share of what it gives bright
# samples (0.99 quantile). Chosen by hand, as in the report.
_DARK = 0.02
# Kinds of findings after which photographs held out, which are wrong alike, test nothing.
_WRONG_ALIKE = ("order", "unrelated", "motion")


@dataclass(frozen=True)
class Verdicts:
    """An estimate judged by three questions.

    Parameters
    ----------
    correspondence : Verdict
        Whether the strongest projector pixel of each lit camera pixel is the right one.
    relighting : Verdict
        Whether T predicts photographs that were held out.
    transport : Verdict
        Whether it is T; the overall verdict.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> judged = lm.verdicts(lm.estimate(capture, coherent=False, iterations=20))
    >>> judged.relighting.level, sorted(judged.as_dict())
    ('not tested', ['correspondence', 'relighting', 'transport'])
    """

    correspondence: Verdict
    relighting: Verdict
    transport: Verdict

    @classmethod
    def from_dict(cls, verdicts: Mapping[str, Mapping[str, Any]]) -> Self:
        """The verdicts of `as_dict`."""
        return cls(
            **{name: Verdict(each["verdict"], each["sentence"]) for name, each in verdicts.items()}
        )

    def as_dict(self) -> dict[str, dict[str, str]]:
        """The verdicts by their names, each with `verdict` and `sentence`, JSON-ready."""
        return {
            name: {"verdict": each.level, "sentence": each.sentence}
            for name, each in vars(self).items()
        }

    def lines(self) -> list[str]:
        """A line for each verdict, the overall one first."""
        return [
            f"T: {self.transport}",
            f"Relighting: {self.relighting}",
            f"Correspondence: {self.correspondence}",
        ]


def verdicts(transport: LightTransport) -> Verdicts:
    """Judge the correspondence, the relighting and the T of an estimate.

    Parameters
    ----------
    transport : LightTransport
        An estimate.

    Returns
    -------
    Verdicts
        "not tested" where nothing bears on a question.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> lm.verdicts(lm.estimate(capture)).relighting.level
    'good'
    """
    kinds = stored_findings(transport)
    return Verdicts(
        correspondence_verdict(transport, kinds),
        relighting_verdict(transport, kinds),
        verdict(transport),
    )


def correspondence_verdict(transport: LightTransport, findings: Iterable[str] = ()) -> Verdict:
    """Judge the map of strongest projector pixels by the share of lit pixels that are certain."""
    certain = np.asarray(transport.diagnostics.get("certain", np.zeros(0)), float)
    known = np.isfinite(certain)
    if known.any():
        white = transport.relight(np.ones(transport.projector_shape, np.float32)).ravel()
        known &= white > _DARK * np.quantile(white, 0.99)
    if not known.any():
        return Verdict(
            "not tested", "Whether the strongest projector pixels are certain is not known."
        )
    share = float(certain[known].mean())
    level: Level = "doubtful"
    if share >= _CERTAIN_FAIR:
        level = "good" if share >= _CERTAIN_GOOD else "fair"
    sentence = (
        f"{percent(share)} of the lit camera pixels are certain of the projector pixel that they "
        "see most."
    )
    return _with_doubt(Verdict(level, sentence), findings)


def relighting_verdict(transport: LightTransport, findings: Iterable[str] = ()) -> Verdict:
    """Judge the images that T predicts by the photographs held out of the last round."""
    error = prediction_error(transport)
    if error is None:
        return Verdict("not tested", "No photograph could be held out and predicted.")
    sentence = f"Prediction error on photographs held out: {percent(error)}."
    return _with_doubt(Verdict(level_of(error), sentence), findings)


def _with_doubt(judged: Verdict, findings: Iterable[str]) -> Verdict:
    """A verdict, doubtful if the photographs are wrong alike."""
    wrong = sorted(set(findings) & set(_WRONG_ALIKE))
    if not wrong:
        return judged
    doubt = f"But the check found what no photograph held out shows ({', '.join(wrong)})."
    return Verdict("doubtful", f"{judged.sentence} {doubt}")
