"""What `lightmatrix estimate` does before the rows: it checks frames, and finds responses."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import lightmatrix as lm
from lightmatrix.cli.options import AUTO
from lightmatrix.cli.terminal import warn

if TYPE_CHECKING:
    from lightmatrix import (
        Capture,
        EstimateSettings,
        Finding,
        FoundResponse,
        ResourceEstimate,
    )
    from lightmatrix.estimators.base import Estimator


def prepared(
    capture: Capture,
    whole: Capture,
    settings: EstimateSettings,
    resources: ResourceEstimate,
    check: bool,
) -> tuple[Capture, FoundResponse | None, Estimator, list[Finding]]:
    """Check the frames of the `whole` capture, find unknown responses, and choose the estimator."""
    check_frames = partial(_findings, whole) if check else list
    found = None
    if whole.projector_unknown or whole.decoder.response.name == AUTO:
        findings = check_frames()
        _warn_of(findings)
        found = _found_response(capture, settings)
        capture = found.applied_to(capture)
        estimator = lm.choose_estimator(capture, settings, resources)
    else:
        estimator, findings = lm.check_and_choose(check_frames, capture, settings, resources)
        _warn_of(findings)
    if settings.is_coherent(capture) and isinstance(estimator, lm.PlainEstimator):
        warn("estimating row by row, which predicts held-out photographs better than --coherent")
    return capture, found, estimator, findings


def _findings(whole: Capture) -> list[Finding]:
    """What `check` finds but for responses that are found later; refuses frames out of order."""
    findings = lm.check(whole)
    lm.refuse_disorder(findings)
    found_later = [whole.projector_unknown and "projector"]
    found_later += [whole.decoder.response.name == AUTO and "response"]
    return [each for each in findings if each.kind not in found_later]


def _warn_of(findings: list[Finding]) -> None:
    for finding in findings:
        warn(f"{finding.kind}: {finding.message}\n  {finding.advice}", style="yellow")


def _found_response(capture: Capture, settings: EstimateSettings) -> FoundResponse:
    """What is found of the responses that the capture leaves open."""
    if capture.projector_unknown:
        warn("looking for the projector's response ...")
        found = lm.find_projector_response(capture, settings)
    else:
        warn("looking for the camera's response ...")
        found = lm.find_response(capture, settings)
    warn(f"response: {found}")
    return found
