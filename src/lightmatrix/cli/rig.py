"""`lightmatrix rig`: lists devices, and measures a projector and a camera part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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
from lightmatrix.cli.terminal import say, show_json, stages

app = typer.Typer(
    help="Measure a projector and a camera.",
    add_completion=False,
    rich_markup_mode=None,
    no_args_is_help=True,
)


@app.command("list")
def list_(as_json: Json = False) -> None:
    """List projectors and cameras, and what is not installed."""
    back_ends = lm.list_devices()
    if as_json:
        show_json({"back_ends": [asdict(back) for back in back_ends]})
        return
    for role in ("projector", "camera"):
        say(f"{role}s")
        for back in (each for each in back_ends if each.role == role):
            say(f"  {back.kind:8} {back.summary}: --{role} {back.form}")
            for device in back.found:
                say(f"             {device.address}  {device.description}", style="green")
            if back.problem:
                say(f"             {back.problem}", style="yellow")
                say(f"             {back.hint}")
            elif back.finds and not back.found:
                say("             none is found")


def _settle(part: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f"settled after {1000 * part['seconds']:.1f} ms; {part['late']} of {part['changes']} "
        "changes came later"
    )


def _exposure(part: Mapping[str, Any]) -> Iterator[str]:
    for seconds, clipped in zip(part["seconds"], part["clipped"], strict=True):
        yield f"{1000 * seconds:.3g} ms, {100 * clipped:.1f} % of its samples will clip"
    yield (
        f"patterns with {100 * part['density']:.0f} % lit; noise "
        f"{100 * part['noise']:.2f} % of the clip level, black level {part['pedestal']:.1f}"
    )


def _response(part: Mapping[str, Any]) -> Iterator[str]:
    yield f"the projector's gamma is {part['gamma']:.2f}; grey patterns are corrected by it"


def _linearity(part: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f"off a straight line by {100 * part['deviation']:.1f} % at most; level goes with the "
        f"exposure to the power of {part['exponent']:.3f}"
    )


def _flicker(part: Mapping[str, Any]) -> Iterator[str]:
    if part["frequency"]:
        yield (
            f"flickers by {100 * part['amplitude']:.1f} % at {part['frequency']:g} Hz: exposures "
            f"are made multiples of {1000 / part['frequency']:.2f} ms"
        )
    else:
        yield f"no flicker noticed; brightness varies by {100 * part['spread']:.2f} %"
    yield f"the room's light varies by {100 * part['room']:.2f} % of white"


# Each part of a rig that a command measures, with its help text and the lines that describe it.
_PARTS: dict[str, tuple[str, Callable[[Mapping[str, Any]], Iterator[str]]]] = {
    "settle": ("Measure the shortest safe delay between showing and exposing.", _settle),
    "exposure": ("Choose exposures from a white picture.", _exposure),
    "response": ("Measure the projector's light for each grey value.", _response),
    "linearity": ("Test whether twice the exposure gives twice the level.", _linearity),
    "flicker": ("Test whether the projector or the room flickers.", _flicker),
}


def _add_command(part: str) -> None:
    text, describe = _PARTS[part]

    @app.command(part, help=text)
    def command(
        rig: RigName = None,
        projector: ProjectorName = None,
        camera: CameraName = None,
        patience: Patience = USUAL_PATIENCE,
        rig_file: RigFile = Path(RIG_FILE),
        as_json: Json = False,
    ) -> None:
        opened = lm.open_rig(rig, projector=projector, camera=camera, patience=patience)
        with opened, stages() as shown:
            known = lm.measure_rig(opened, [part], keep=rig_file, progress=shown.measured)
        measured: dict[str, Any] = known.as_dict()[part]
        if as_json:
            show_json({"rig_file": rig_file, part: measured})
            return
        for line in describe(measured):
            say(line)
        for warning in measured.get("warnings", ()):
            say(warning, style="yellow")


for _part in _PARTS:
    _add_command(_part)
