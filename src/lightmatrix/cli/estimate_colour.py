"""`lightmatrix estimate` of photographs under patterns in colour."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.terminal import progress, say, show_json, warn
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.outputs.kinds import COLOUR_STORES

if TYPE_CHECKING:
    from lightmatrix import Capture, EstimateSettings


def in_colour(capture: Capture) -> bool:
    """Whether the patterns of a capture show several colours."""
    return isinstance(capture.patterns, lm.ColourPatterns)


def estimate_colour(
    capture: Capture,
    output: Path,
    settings: EstimateSettings,
    options: Mapping[str, object],
    *,
    check: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Estimate the T of a colour projector into a folder of three stores.

    It has no settings. Those that are given, and further `options`, by name, are refused.
    """
    usual = asdict(lm.EstimateSettings(coherent=settings.coherent or None))
    given = [
        f"--{name.replace('_', '-')}"
        for name, value in asdict(settings).items()
        if value != usual[name]
    ]
    given += [name for name, value in options.items() if value]
    if given:
        raise InputError(
            f"{', '.join(given)} for patterns in colour",
            hint="leave it out: their estimate has no such option",
        )
    if output.suffix.lower() == ".zarr":
        raise InputError(
            f"{output} for patterns in colour, whose T is a folder of three stores",
            hint=f"name a folder: -o {output.with_suffix('')}",
        )
    claim(output, COLOUR_STORES, overwrite=overwrite)
    started = time.perf_counter()
    with progress("estimating", "rows") as step:
        colour = lm.estimate_colour(
            capture, output=output, overwrite=overwrite, check=check, progress=step
        )
    findings = colour.red.provenance["findings"]
    for finding in findings:
        warn(f"{finding['kind']}: {finding['message']}\n  {finding['advice']}", style="yellow")
    judged = lm.verdicts(colour.red)
    if as_json:
        overall = judged.transport
        stores = {name: str(output / f"{name}.zarr") for name in COLOURS}
        seconds = round(time.perf_counter() - started, 2)
        result = {"output": str(output), "stores": stores, "seconds": seconds}
        result |= {"verdict": overall.level, "sentence": overall.sentence}
        result |= {"verdicts": judged.as_dict()}
        show_json(result | {"findings": findings})
        return
    for line in judged.lines():
        say(line)
    say(f"{', '.join(f'{name}.zarr' for name in COLOURS)} in {output}")
