"""Making a report: what is known is gathered, judged and written as one page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.estimators.work import Progress
from lightmatrix.evaluation.verdict import percent
from lightmatrix.outputs.kinds import REPORT
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.report.elements import Points, Section
from lightmatrix.report.facts import Facts
from lightmatrix.report.page import Page, html
from lightmatrix.report.recommendations import advice
from lightmatrix.report.sections.error_estimates import solved
from lightmatrix.report.sections.parameters import parameters
from lightmatrix.report.sections.photographs import captured, order
from lightmatrix.report.sections.relighting import relit
from lightmatrix.report.sections.transport_matrix import found
from lightmatrix.report.validation import Estimator, HeldOut, hold_out
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport


class Finding(Protocol):
    """One thing that is wrong with a capture, as its checks tell it."""

    @property
    def kind(self) -> str:
        """In a word."""

    @property
    def frames(self) -> Sequence[int]:
        """The frames that it is about; empty for all of them."""

    @property
    def message(self) -> str:
        """What was found."""

    @property
    def advice(self) -> str:
        """What to do."""


# What a report folder holds.
PAGE, NUMBERS = "report.html", "report.json"
# Of the frames of a finding.
_MOST_NAMED = 8


def report(
    folder: str | Path,
    transport: LightTransport,
    capture: Capture,
    *,
    truth: LightTransport | Truth | None = None,
    estimator: Estimator | EstimateSettings | None = None,
    held_out: bool = True,
    findings: Sequence[Finding] = (),
    title: str = "Light transport",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a report of an estimate: one page of HTML with everything inside.

    Parameters
    ----------
    folder : str or Path
        The folder to make: report.html, and its numbers as report.json.
    transport : LightTransport
        The estimate.
    capture : Capture
        What it was made from.
    truth : LightTransport or Truth, optional
        T, where it is known, such as that of a simulated capture.
    estimator : EstimateSettings or an estimator, optional
        How the estimate was made, for the one that predicts photographs held out. None: as
        `estimate` does when nothing is said.
    held_out : bool
        Whether to hold out a few photographs and estimate once more from the others: as slow as
        the estimate itself, on 16,384 camera samples at most.
    findings : sequence of Finding
        What is wrong with the frames: each has a kind, frames, a message and an advice.
    title : str
        What the report is about.
    overwrite : bool
        Whether an existing report may be replaced.
    progress : callable, optional
        Called with (done, total) rows of the second estimate.

    Returns
    -------
    dict
        What report.json holds: the verdict in a word (good, fair, doubtful or not tested) and in a
        sentence, the relative errors of photographs held out and against the truth (None where
        there is none), and the advice. JSON-ready.

    Raises
    ------
    InputError
        If the matrices and the capture do not belong to one rig.
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=20)
    >>> told = lm.report("report", estimate, capture, truth=capture.truth, held_out=False)
    >>> sorted(told)[-2:], 0 < told["relative_error"] < 1
    (['sentence', 'verdict'], True)
    """
    known = truth.transport() if isinstance(truth, Truth) else truth
    _check(transport, capture, known)
    with atomic_folder(folder, REPORT, overwrite=overwrite) as part:
        return write_page(
            part,
            transport,
            capture,
            truth=known,
            estimator=estimator,
            held_out=held_out,
            findings=findings,
            title=title,
            progress=progress,
        )


def write_page(
    folder: Path,
    transport: LightTransport,
    capture: Capture,
    *,
    truth: LightTransport | None = None,
    estimator: Estimator | EstimateSettings | None = None,
    held_out: bool = True,
    findings: Sequence[Finding] = (),
    title: str,
    more: Sequence[Section] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write the files of a report into an existing folder; see `report`.

    Parameters
    ----------
    more : sequence of Section
        Further sections, before the parameters.
    """
    held: HeldOut | str = "nobody asked for it"
    if held_out:
        held = hold_out(capture, estimator or EstimateSettings(), progress=progress)
    facts = Facts(transport, capture, truth, held)
    todo = advice(facts)
    page = Page(
        title,
        facts.verdict,
        _numbers(facts),
        tuple(_told(finding) for finding in findings),
        order(facts),
        (
            captured(facts),
            solved(facts),
            found(facts),
            relit(facts),
            *more,
            Section("next", "What to do better next time", "", (Points(todo),)),
            parameters(facts),
        ),
        __version__,
    )
    result: dict[str, Any] = {
        "verdict": facts.verdict.level,
        "sentence": facts.verdict.sentence,
        "held_out_error": held.error if isinstance(held, HeldOut) else None,
        "held_out_frames": held.frames.tolist() if isinstance(held, HeldOut) else [],
        "mean_photograph_error": held.trivial_error if isinstance(held, HeldOut) else None,
        "relative_error": facts.relative_error,
        "clipped_samples": float(facts.frames.clipped.mean()),
        "findings": [finding.kind for finding in findings],
        "advice": list(todo),
    }
    (folder / PAGE).write_text(html(page), encoding="utf-8")
    (folder / NUMBERS).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def _told(finding: Finding) -> str:
    """A finding in words, with its frames."""
    some = ", ".join(map(str, finding.frames[:_MOST_NAMED]))
    if len(finding.frames) > _MOST_NAMED:
        some += f" and {len(finding.frames) - _MOST_NAMED} more"
    where = f" (frames {some})" if some else ""
    return f"{finding.message}{where}. {finding.advice[:1].upper()}{finding.advice[1:]}."


def _numbers(facts: Facts) -> dict[str, str]:
    capture, transport = facts.capture, facts.transport
    numbers = {
        "camera": " x ".join(map(str, transport.camera_shape)),
        "projector": " x ".join(map(str, transport.projector_shape)),
        "photographs": str(capture.count),
        "samples that clipped": percent(float(facts.frames.clipped.mean())),
    }
    if isinstance(facts.held, HeldOut):
        numbers["photographs held out missed by"] = percent(facts.held.error)
    if facts.relative_error is not None:
        numbers["error of T"] = percent(facts.relative_error)
    return numbers


def _check(transport: LightTransport, capture: Capture, truth: LightTransport | None) -> None:
    for name in ("camera_shape", "projector_shape"):
        shape = getattr(transport, name)
        for what, other in (("capture", capture), ("truth", truth)):
            if other is not None and getattr(other, name) != shape:
                raise InputError(
                    f"the estimate's {name.replace('_', ' ')} is {shape}, the {what}'s "
                    f"{getattr(other, name)}",
                    hint="give the capture that it was made from, binned alike",
                )
