"""`lm.report`: writes the report of an estimate."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.responses.found import as_estimated
from lightmatrix.errors import InputError
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.evaluation.judgement import (
    Verdicts,
    correspondence_verdict,
    percent,
    stored_findings,
)
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.outputs.kinds import REPORT
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.report.elements import Points, Section
from lightmatrix.report.facts import Facts
from lightmatrix.report.page import Page, html
from lightmatrix.report.recommendations import recommendations
from lightmatrix.report.sections.error_estimates import error_estimates
from lightmatrix.report.sections.parameters import parameters
from lightmatrix.report.sections.photographs import first_frames, photographs
from lightmatrix.report.sections.relighting import relighting
from lightmatrix.report.sections.transport_matrix import transport_matrix
from lightmatrix.report.sections.uses import uses
from lightmatrix.report.validation import Estimator, Validation, validate
from lightmatrix.simulation.truth import Truth
from lightmatrix.solvers.loop import Progress
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.triangulation import geometry_of
from lightmatrix.viewer.export import export_viewer

# The files of a report folder.
PAGE, NUMBERS, VIEWER = "report.html", "report.json", "viewer.html"
# A finding lists at most this many frames.
_MOST_LISTED = 8


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
    viewer: bool = False,
    geometry: RigGeometry | str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a report of an estimate: one self-contained page of HTML.

    Parameters
    ----------
    folder : str or Path
        The folder to make: report.html, and its numbers as report.json.
    transport : LightTransport
        The estimate.
    capture : Capture
        The capture of the estimate.
    truth : LightTransport or Truth, optional
        T, where it is known, such as that of a simulated capture.
    estimator : EstimateSettings or an estimator, optional
        The estimator of the estimate. It estimates T again to predict unseen photographs. None:
        the default of `estimate`.
    held_out : bool
        Whether to hold out a few photographs, estimate T again from the others, and predict the
        unseen ones. That takes as long as the estimate itself, on at most 16,384 camera samples.
    findings : sequence of Finding
        Problems of the frames, as `check` finds them.
    title : str
        Title of the page.
    viewer : bool
        Whether to write the viewer too, as viewer.html, and link to it; see `export_viewer`.
    geometry : RigGeometry, str or Path, optional
        Where camera and projector stand, or its file. The report and the viewer then show depth,
        the report normals too.
    overwrite : bool
        Whether an existing report may be replaced.
    progress : callable, optional
        Called with (done, total) rows of the second estimate.

    Returns
    -------
    dict
        The content of report.json, JSON-ready: the verdict on T in a word (good, fair, doubtful or
        not tested) and in sentences, those of `verdicts`, the relative errors on unseen photographs
        and against the truth (None where there is none), and the recommendations.

    Raises
    ------
    InputError
        If the matrices, the capture and the geometry do not belong to one rig, or T is too large
        for the viewer's page.
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=20)
    >>> numbers = lm.report("report", estimate, capture, truth=capture.truth, held_out=False)
    >>> sorted(numbers)[-2:], 0 < numbers["relative_error"] < 1
    (['verdict', 'verdicts'], True)
    """
    known = truth.transport() if isinstance(truth, Truth) else truth
    capture = as_estimated(capture, transport.provenance)
    _check(transport, capture, known)
    rig = None if geometry is None else geometry_of(transport, geometry)
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
            viewer=viewer,
            geometry=rig,
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
    viewer: bool = False,
    geometry: RigGeometry | None = None,
    more: Sequence[Section] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write the files of `report` into an existing folder, with `more` sections near the end."""
    validation: Validation | str = "the test was not requested"
    if held_out:
        validation = validate(capture, estimator or EstimateSettings(), progress=progress)
    facts = Facts(transport, capture, truth, validation, geometry)
    advice = recommendations(facts)
    kinds = {*stored_findings(transport), *(finding.kind for finding in findings)}
    judged = facts.verdict
    if facts.relative_error is None:
        judged = judged.with_findings(kinds)
    of_each = Verdicts(correspondence_verdict(transport, kinds), facts.relighting_verdict, judged)
    if viewer:
        export_viewer(folder / VIEWER, transport, geometry=geometry)
    page = Page(
        title,
        of_each,
        _first_numbers(facts),
        VIEWER if viewer else None,
        tuple(_sentences(finding) for finding in findings),
        first_frames(facts),
        (
            photographs(facts),
            error_estimates(facts),
            transport_matrix(facts),
            relighting(facts),
            uses(facts),
            *more,
            Section("recommendations", "Recommendations", "", (Points(advice),)),
            parameters(facts),
        ),
        __version__,
    )
    test = validation if isinstance(validation, Validation) else None
    result: dict[str, Any] = {
        "verdict": judged.level,
        "sentence": judged.sentence,
        "verdicts": of_each.as_dict(),
        "held_out_error": test.error if test else None,
        "held_out_frames": test.frames.tolist() if test else [],
        "mean_photograph_error": test.mean_error if test else None,
        "relative_error": facts.relative_error,
        "clipped_samples": float(facts.frames.clipped.mean()),
        "findings": [finding.kind for finding in findings],
        "advice": list(advice),
    }
    # A file name that is no text holds characters that UTF-8 has no code for.
    (folder / PAGE).write_text(html(page), encoding="utf-8", errors="replace")
    (folder / NUMBERS).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def _sentences(finding: Finding) -> str:
    """A finding in words, with its frames."""
    frames = ", ".join(map(str, finding.frames[:_MOST_LISTED]))
    if len(finding.frames) > _MOST_LISTED:
        frames += f" and {len(finding.frames) - _MOST_LISTED} more"
    where = f" (frames {frames})" if frames else ""
    return f"{_capital(finding.message)}{where}. {_capital(finding.advice)}."


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _first_numbers(facts: Facts) -> dict[str, str]:
    capture, transport = facts.capture, facts.transport
    numbers = {
        "camera": " x ".join(map(str, transport.camera_shape)),
        "projector": " x ".join(map(str, transport.projector_shape)),
        "photographs": str(capture.count),
        "clipped samples": percent(float(facts.frames.clipped.mean())),
    }
    if isinstance(facts.validation, Validation):
        numbers["prediction error on unseen photographs"] = percent(facts.validation.error)
    if facts.relative_error is not None:
        numbers["error of T against the truth"] = percent(facts.relative_error)
    return numbers


def _check(transport: LightTransport, capture: Capture, truth: LightTransport | None) -> None:
    for name in ("camera_shape", "projector_shape"):
        shape = getattr(transport, name)
        for origin, other in (("capture", capture), ("truth", truth)):
            if other is not None and getattr(other, name) != shape:
                raise InputError(
                    f"the estimate's {name.replace('_', ' ')} is {shape}, the {origin}'s is "
                    f"{getattr(other, name)}",
                    hint="give the capture of this estimate, with the same binning",
                )
