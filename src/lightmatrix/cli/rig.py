"""`lightmatrix rig`: what is known of a projector and a camera, measured part by part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

import lightmatrix as lm
from lightmatrix.cli.options import (
    RIG_FILE,
    USUAL_PATIENCE,
    CameraName,
    Json,
    Patience,
    ProjectorName,
    RigFile,
    RigName,
)
from lightmatrix.cli.stages import stages
from lightmatrix.cli.terminal import say, show_json

app = typer.Typer(
    help="Measure a projector and a camera.",
    add_completion=False,
    rich_markup_mode=None,
    no_args_is_help=True,
)


@app.command("list")
def list_(as_json: Json = False) -> None:
    """List the projectors and cameras that are there, and what each kind lacks."""
    listed = lm.list_devices()
    if as_json:
        show_json({"back_ends": [asdict(back) for back in listed]})
        return
    for role in ("projector", "camera"):
        say(f"{role}s")
        for back in (each for each in listed if each.role == role):
            say(f"  {back.kind:8} {back.summary}: --{role} {back.form}")
            for found in back.found:
                say(f"             {found.address}  {found.description}", style="green")
            if back.problem:
                say(f"             {back.problem}", style="yellow")
                say(f"             {back.hint}")
            elif back.finds and not back.found:
                say("             none is found")


@app.command()
def settle(
    rig: RigName = None,
    projector: ProjectorName = None,
    camera: CameraName = None,
    patience: Patience = USUAL_PATIENCE,
    rig_file: RigFile = Path(RIG_FILE),
    as_json: Json = False,
) -> None:
    """Measure the shortest safe delay between showing and exposing."""
    told = _measure("settle", rig, projector, camera, patience, rig_file, as_json)
    if told:
        say(
            f"settled after {1000 * told['seconds']:.1f} ms; {told['late']} of {told['changes']} "
            "changes came later"
        )


@app.command()
def exposure(
    rig: RigName = None,
    projector: ProjectorName = None,
    camera: CameraName = None,
    patience: Patience = USUAL_PATIENCE,
    rig_file: RigFile = Path(RIG_FILE),
    as_json: Json = False,
) -> None:
    """Choose exposures from a white picture."""
    told = _measure("exposure", rig, projector, camera, patience, rig_file, as_json)
    if not told:
        return
    for seconds, clipped in zip(told["seconds"], told["clipped"], strict=True):
        say(f"{1000 * seconds:.3g} ms, {100 * clipped:.1f} % of its samples will clip")
    say(
        f"patterns with {100 * told['density']:.0f} % lit; noise "
        f"{100 * told['noise']:.2f} % of the clip level, black level {told['pedestal']:.1f}"
    )
    for text in told["warnings"]:
        say(text, style="yellow")


@app.command()
def response(
    rig: RigName = None,
    projector: ProjectorName = None,
    camera: CameraName = None,
    patience: Patience = USUAL_PATIENCE,
    rig_file: RigFile = Path(RIG_FILE),
    as_json: Json = False,
) -> None:
    """Measure the projector's light for each grey value."""
    told = _measure("response", rig, projector, camera, patience, rig_file, as_json)
    if told:
        say(f"the projector's gamma is {told['gamma']:.2f}; grey patterns are corrected by it")


@app.command()
def linearity(
    rig: RigName = None,
    projector: ProjectorName = None,
    camera: CameraName = None,
    patience: Patience = USUAL_PATIENCE,
    rig_file: RigFile = Path(RIG_FILE),
    as_json: Json = False,
) -> None:
    """Test whether twice the exposure gives twice the level."""
    told = _measure("linearity", rig, projector, camera, patience, rig_file, as_json)
    if told:
        say(
            f"off a straight line by {100 * told['deviation']:.1f} % at most; level goes with the "
            f"exposure to the power of {told['exponent']:.3f}"
        )


@app.command()
def flicker(
    rig: RigName = None,
    projector: ProjectorName = None,
    camera: CameraName = None,
    patience: Patience = USUAL_PATIENCE,
    rig_file: RigFile = Path(RIG_FILE),
    as_json: Json = False,
) -> None:
    """Test whether the projector's light, or the room's, comes and goes."""
    told = _measure("flicker", rig, projector, camera, patience, rig_file, as_json)
    if not told:
        return
    if told["frequency"]:
        say(
            f"flickers by {100 * told['amplitude']:.1f} % at {told['frequency']:g} Hz: exposures "
            f"are made multiples of {1000 / told['frequency']:.2f} ms"
        )
    else:
        say(f"no flicker noticed; brightness varies by {100 * told['spread']:.2f} %")
    say(f"the room's light varies by {100 * told['room']:.2f} % of white")


def _measure(
    part: str,
    rig: str | None,
    projector: str | None,
    camera: str | None,
    patience: float,
    rig_file: Path,
    as_json: bool,
) -> Mapping[str, Any]:
    """What was measured; nothing where it has been shown as JSON."""
    opening = lm.open_rig(rig, projector=projector, camera=camera, patience=patience)
    with opening as opened, stages() as shown:
        known = lm.measure_rig(opened, [part], keep=rig_file, progress=shown.measured)
    told: dict[str, Any] = known.as_dict()[part]
    if as_json:
        show_json({"rig_file": rig_file, part: told})
        return {}
    return told
