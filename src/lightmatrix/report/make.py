"""`lm.report`: writes the report of an estimate."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from lightmatrix._version import __version__
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.found_response import as_estimated
from lightmatrix.check.finding import Finding
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.files.kinds import REPORT
from lightmatrix.files.writing import atomic_folder
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.judgement import judgement
from lightmatrix.judgement.metrics import check_same_rig
from lightmatrix.progress import Progress
from lightmatrix.report import sections
from lightmatrix.report.elements import Section
from lightmatrix.report.facts import AnyEstimator, Facts, Validation, validate
from lightmatrix.reprs import percent
from lightmatrix.rig_model.model import RigModel
from lightmatrix.shape.triangulation import geometry_of
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.export import export_viewer


def recommendations(facts: Facts) -> tuple[str, ...]:
    """Recommendations for the next capture, the most urgent first. Limits were chosen by hand."""
    transport, frames, validation = facts.transport, facts.frames, facts.validation
    sentences = list[str]()
    often = float(np.mean(np.asarray(transport.diagnostics.get("clipped_share", 0.0)) > 0.5))
    if facts.own.singly_clipped > judgement.SINGLY_CLIPPED:
        sentences.append(
            f"{percent(facts.own.singly_clipped)} of the squared light is in rows that clip "
            "whenever their strongest projector pixel is lit, so that this entry is only a lower "
            "bound. Take a few frames at a quarter of the exposure (`lightmatrix plan` says how "
            "many)."
        )
    elif often > 0.1:
        sentences.append(
            f"{percent(often)} of the rows clipped in more than half of their samples. Choose an "
            "exposure at which a white pattern just does not clip, or light fewer projector pixels "
            "at a time (`lightmatrix plan` on a white frame)."
        )
    brightest = float(frames.level.max())
    if brightest < 0.1 and float(frames.clipped.max()) < 0.001:
        # Half of the clip level is wanted, in one step of at most 8.
        factor = min(8.0, 0.5 / max(brightest, 1e-3))
        sentences.append(
            f"The brightest frame reaches {percent(brightest)} of the clip level on average, and "
            f"nothing clips. An exposure {factor:.2g} times as long would leave less noise."
        )
    if isinstance(validation, Validation) and validation.error > judgement.GOOD:
        count = facts.capture.count
        sentences.append(
            f"Prediction error on unseen photographs: {percent(validation.error)}. More patterns "
            f"({2 * count} instead of {count}) would lower it, if the frames follow the patterns "
            "and are linear in light, and the camera did not move."
        )
    mixed = bool(np.any(facts.capture.patterns.kinds))
    if facts.diffuse_error > 2 * judgement.GOOD and not mixed:
        sentences.append(
            "Coarse patterns among the fine ones resolve the rows that hardly see direct light "
            f"(error: {percent(facts.diffuse_error)}): `lightmatrix patterns mix`."
        )
    elif transport.background_share > 0.3 and not mixed:
        sentences.append(
            f"{percent(transport.background_share)} of the light is in the faint background. A few "
            "coarse patterns among the fine ones resolve it (`lightmatrix patterns mix`)."
        )
    return tuple(sentences) or (
        "Nothing needs to change: use the same exposure, patterns and number of photographs.",
    )


def _code(text: str) -> Markup:
    """Escaped text with `words` in backticks as code, and no line break before a %."""
    together = str(escape(text)).replace(" %", "\N{NO-BREAK SPACE}%")
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", together))


def report(
    folder: str | Path,
    transport: LightTransport,
    capture: Capture,
    *,
    truth: LightTransport | Truth | None = None,
    estimator: AnyEstimator | EstimateSettings | None = None,
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
    capture = RigModel.of(transport).corrected(capture, transport)
    check_same_rig(transport, capture, "capture")
    if known is not None:
        check_same_rig(transport, known)
    rig = None if geometry is None else geometry_of(transport, geometry)
    with atomic_folder(folder, REPORT, overwrite=overwrite) as part:
        validation: Validation | str = "the test was not requested"
        if held_out:
            validation = validate(capture, estimator or EstimateSettings(), progress=progress)
        facts = Facts(transport, capture, known, validation, rig)
        return write_page(part, facts, title, findings=findings, viewer=viewer)


def write_page(
    folder: Path,
    facts: Facts,
    title: str,
    *,
    findings: Sequence[Finding] = (),
    viewer: bool = False,
    more: Sequence[Section] = (),
) -> dict[str, Any]:
    """Write the files of `report` into an existing folder, with `more` sections near the end."""
    transport, capture = facts.transport, facts.capture
    kinds = {*judgement.stored_findings(transport), *(finding.kind for finding in findings)}
    judged = facts.verdict
    if facts.relative_error is None:
        judged = judged.with_findings(kinds)
    of_each = judgement.Verdicts(
        judgement.correspondence_verdict(transport, kinds), facts.relighting_verdict, judged
    )
    if viewer:
        export_viewer(folder / "viewer.html", transport, geometry=facts.geometry)
    clipped = float(facts.frames.clipped.mean())
    first_numbers = {
        "camera": " x ".join(map(str, transport.camera_shape)),
        "projector": " x ".join(map(str, transport.projector_shape)),
        "photographs": str(capture.count),
        "clipped samples": percent(clipped),
    }
    test = facts.validation if isinstance(facts.validation, Validation) else None
    if test is not None:
        first_numbers["prediction error on unseen photographs"] = percent(test.error)
    if facts.relative_error is not None:
        first_numbers["error of T against the truth"] = percent(facts.relative_error)
    advice = recommendations(facts)
    # One HTML document that needs no network and no script.
    environment = Environment(
        loader=PackageLoader("lightmatrix.report"),
        # Names and values are text, whatever they hold.
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _code
    page = environment.get_template("report.html").render(
        title=title,
        verdicts=of_each,
        numbers=first_numbers,
        viewer="viewer.html" if viewer else None,
        findings=[_sentences(finding) for finding in findings],
        first=sections.first_pictures(facts),
        advice=advice,
        sections=(
            sections.relighting(facts),
            sections.transport_matrix(facts),
            sections.uses(facts),
            sections.error_estimates(facts),
            *more,
            sections.photographs(facts),
            sections.parameters(facts),
        ),
        version=__version__,
    )
    result: dict[str, Any] = {
        "verdict": judged.level, "sentence": judged.sentence, "verdicts": of_each.as_dict(),
        "held_out_error": test.error if test else None,
        "held_out_frames": test.frames.tolist() if test else [],
        "mean_photograph_error": test.mean_error if test else None,
        "relative_error": facts.relative_error, "clipped_samples": clipped,
        "findings": [finding.kind for finding in findings], "advice": list(advice),
    }  # fmt: skip
    # A file name that is no text holds characters that UTF-8 has no code for.
    (folder / "report.html").write_text(page + "\n", encoding="utf-8", errors="replace")
    (folder / "report.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def _sentences(finding: Finding) -> str:
    """A finding in words, with its first frames."""
    frames = ", ".join(map(str, finding.frames[:8]))
    if len(finding.frames) > 8:
        frames += f" and {len(finding.frames) - 8} more"
    where = f" (frames {frames})" if frames else ""
    message, advice = (text[:1].upper() + text[1:] for text in (finding.message, finding.advice))
    return f"{message}{where}. {advice}."
