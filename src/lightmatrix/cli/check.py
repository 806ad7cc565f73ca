"""`lightmatrix check`: what is wrong with a capture, before anything is estimated from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Json, ResponseCurve
from lightmatrix.cli.source import (
    Black,
    BlackExposure,
    BlackLevel,
    ClipLevel,
    Crop,
    Exposure,
    Folder,
    FullScale,
    Images,
    Mask,
    Mosaic,
    Patterns,
    Photographs,
    ProjectorCurve,
    White,
    source,
)
from lightmatrix.cli.terminal import say, show_json

if TYPE_CHECKING:
    from lightmatrix import Finding

# What `check` exits with if it finds something.
FOUND = 1


def check(
    capture: Folder = None,
    photographs: Photographs = None,
    patterns: Patterns = None,
    images: Images = None,
    black: Black = None,
    black_exposure: BlackExposure = None,
    white: White = None,
    mask: Mask = None,
    black_level: BlackLevel = None,
    clip: ClipLevel = None,
    full_scale: FullScale = None,
    response: ResponseCurve = None,
    projector_response: ProjectorCurve = None,
    exposure: Exposure = None,
    crop: Crop = None,
    mosaic: Mosaic = False,
    as_json: Json = False,
) -> None:
    """Tell what is wrong with a capture, and what to do.

    Give a capture folder; or patterns and images, each a folder or a stack. Frames lost, late,
    swapped, black or odd; gamma and JPEG; motion and flicker; light; what the patterns cannot
    tell. Exits with 0 if nothing is found, with 1 if something is.
    """
    where = source(
        capture,
        photographs,
        patterns,
        images,
        crop=crop,
        black=black,
        black_exposure=black_exposure,
        white=white,
        mask=mask,
        black_level=black_level,
        clip=clip,
        full_scale=full_scale,
        response=response,
        projector_response=projector_response,
        exposure=exposure,
        mosaic=mosaic or None,
    )
    findings = lm.check(**where)
    if as_json:
        show_json({"findings": [finding.as_dict() for finding in findings]})
    elif findings:
        show_findings(findings)
    else:
        say("nothing wrong was found")
    if findings:
        raise typer.Exit(FOUND)


def show_findings(findings: list[Finding]) -> None:
    """Print findings, each with what to do."""
    for finding in findings:
        say(f"{finding.kind}: {finding.message}", style="yellow")
        say(f"  {finding.advice}")
