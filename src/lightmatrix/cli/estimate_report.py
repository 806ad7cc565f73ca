"""The report of `lightmatrix estimate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lightmatrix as lm
from lightmatrix.cli.source import Source
from lightmatrix.cli.terminal import progress
from lightmatrix.errors import InputError

if TYPE_CHECKING:
    from lightmatrix import Capture, EstimateSettings, Finding, LightTransport, RigGeometry


def check_report(output: Path, report: Path | None, viewer: bool) -> None:
    """Refuse a viewer without its report, and a report where the estimate goes."""
    if viewer and report is None:
        hint = "add --report, or run `lightmatrix view --export` on the estimate"
        raise InputError("--viewer without --report", hint=hint)
    if report is not None and output.absolute() in (report.absolute(), *report.absolute().parents):
        raise InputError(
            f"{report}: is where the estimate goes", hint="choose another folder for the report"
        )


def write_report(
    folder: Path,
    store: Path,
    source: Source,
    transport: LightTransport,
    capture: Capture,
    settings: EstimateSettings,
    findings: list[Finding],
    viewer: bool,
    geometry: RigGeometry | None,
    overwrite: bool,
) -> dict[str, Any]:
    """Write the report, with the truth if `simulate` left it beside the frames."""
    with progress("predicting held-out photographs", "rows") as step:
        return lm.report(
            folder,
            transport,
            capture,
            truth=_truth(source.folder, transport),
            # The report solves a small part of the camera, for which this process suffices.
            estimator=replace(settings, workers=None, cluster=None),
            title=store.name,
            findings=findings,
            viewer=viewer,
            geometry=geometry,
            overwrite=overwrite,
            progress=step,
        )


def _truth(folder: Path | None, transport: LightTransport) -> LightTransport | None:
    """The true T, if `simulate` wrote it and the capture was not binned."""
    file = None if folder is None else folder / "truth.npz"
    if file is None or not file.is_file():
        return None
    known = lm.truth(str(file)).transport().cropped_like(transport)
    shapes = (known.camera_shape, known.projector_shape)
    return known if shapes == (transport.camera_shape, transport.projector_shape) else None
