"""`lightmatrix rig` and `project`: devices, their measurements, and pictures on a projector."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.help import Command
from lightmatrix.cli.options import CameraName, Json, ProjectorName, RigFile, RigName
from lightmatrix.cli.terminal import Stages, enter_was_pressed, say, show_json
from lightmatrix.defaults import RIG_FILE
from lightmatrix.errors import InputError

app = typer.Typer(
    help="Measure a projector and a camera.", add_completion=False, rich_markup_mode=None
)


@app.command("list", cls=Command)
def list_(as_json: Json = False) -> None:
    """List projectors and cameras, and what is not installed."""
    back_ends = lm.list_devices()
    if as_json:
        calls = ("open", "find")
        listed = [{k: v for k, v in asdict(b).items() if k not in calls} for b in back_ends]
        show_json({"back_ends": listed})
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
            elif back.find is not None and not back.found:
                say("             none is found")


# Each part of a rig that a command measures, with its help text.
_PARTS = {
    "settle": "Measure the shortest safe delay between showing and exposing.",
    "exposure": "Choose exposures from a white picture.",
    "response": "Measure the projector's light for each grey value.",
    "flicker": "Test whether the projector or the room flickers.",
}


def _lines(name: str, part: Mapping[str, Any]) -> Iterator[str]:
    """What was measured of a part, in words."""
    if name == "settle" and not part["changes"]:
        yield f"stated: {part['seconds']:g} s"
    elif name == "settle":
        yield (
            f"settled after {1000 * part['seconds']:.1f} ms; {part['late']} of {part['changes']} "
            "changes came later"
        )
    elif name == "exposure":
        for seconds, clipped in zip(part["seconds"], part["clipped"], strict=True):
            yield f"{1000 * seconds:.3g} ms, {100 * clipped:.1f} % of its samples will clip"
        yield (
            f"patterns with {100 * part['density']:.0f} % lit; noise "
            f"{100 * part['noise']:.2f} % of the clip level, black level {part['pedestal']:.1f}"
        )
    elif name == "response":
        yield f"the projector's gamma is {part['gamma']:.2f}; grey patterns are corrected by it"
    else:
        if part["frequency"]:
            yield (
                f"flickers by {100 * part['amplitude']:.1f} % at {part['frequency']:g} Hz: "
                f"exposures are made multiples of {1000 / part['frequency']:.2f} ms"
            )
        else:
            yield f"no flicker noticed; brightness varies by {100 * part['spread']:.2f} %"
        yield f"the room's light varies by {100 * part['room']:.2f} % of white"


def _add_command(part: str) -> None:
    @app.command(part, cls=Command, help=_PARTS[part])
    def command(
        rig: RigName = None,
        projector: ProjectorName = None,
        camera: CameraName = None,
        settle: Annotated[
            float | None,
            typer.Option(
                help="Seconds to wait after showing a picture; the rig file keeps them.",
                show_default="as measured",
            ),
        ] = None,
        response: Annotated[
            str, typer.Option(help="Response of the camera: linear, gamma:2.2, srgb, FILE.")
        ] = "linear",
        rig_file: RigFile = Path(RIG_FILE),
        as_json: Json = False,
    ) -> None:
        opened = lm.open_rig(rig, projector=projector, camera=camera)
        with opened, Stages() as shown:
            known = lm.measure_rig(
                opened, [part], keep=rig_file, settle=settle, response=response,
                progress=shown.measured,
            )  # fmt: skip
        measured: dict[str, Any] = known.as_dict()[part]
        if as_json:
            show_json({"rig_file": rig_file, part: measured})
            return
        for line in _lines(part, measured):
            say(line)
        for warning in measured.get("warnings", ()):
            say(warning, style="yellow")


for _part in _PARTS:
    _add_command(_part)


@options.described(
    source=Argument(
        metavar="SHOWN",
        help="An image, a folder of images, or a video; or an image for each projector.",
    ),
    photograph=Option(
        "-o", "--photograph", help="Image of what the camera sees of the first picture."
    ),
    seconds=Option(help="How long.", show_default="until a key is pressed"),
    fps=Option(help="Pictures a second.", show_default="25, or as the video says"),
    cell="Projector pixels along a side of each pixel.",
    projector_response=Option(
        metavar="FILE|gamma:2.2",
        help="The pictures hold light, which this encodes.",
        show_default="they hold grey values",
    ),
)
def project(
    source: list[Path],
    projector: options.ProjectorNames = None,
    camera: options.CameraName = None,
    rig: options.RigName = None,
    photograph: Path | None = None,
    seconds: float | None = None,
    fps: float | None = None,
    cell: int = 1,
    projector_response: str | None = None,
    rig_file: options.RigFile = Path(RIG_FILE),
    overwrite: options.Overwrite = False,
) -> None:
    """Show a picture on a projector, pixel by pixel.

    Any key in the window ends it, or Enter in the terminal. With a camera, or on a virtual rig, -o
    writes a photograph of it.
    """
    with_camera = rig is not None or camera is not None
    if not with_camera and projector is None:
        hint = "add --projector window:1; `lightmatrix rig list` names them"
        raise InputError("no projector", hint=hint)
    if rig is not None and photograph is None and seconds is None:
        raise InputError("nobody sees a virtual rig", hint="add -o PHOTOGRAPH.png")
    if photograph is not None:
        options.missing_rig_file(rig_file)
    opened = (
        lm.open_rig(rig, projector=projector, camera=camera)
        if with_camera
        else lm.open_projector(projector or [])
    )
    try:
        lm.project(
            opened, source[0] if len(source) == 1 else source, seconds=seconds, fps=fps, cell=cell,
            projector_response=projector_response, until=enter_was_pressed, photograph=photograph,
            keep=rig_file, overwrite=overwrite,
        )  # fmt: skip
    finally:
        opened.close()
    if photograph is not None:
        say(str(photograph))
