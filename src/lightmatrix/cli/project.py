"""`lightmatrix project`: shows a picture, a folder or a video on a projector."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.terminal import enter_was_pressed, say
from lightmatrix.defaults import RIG_FILE
from lightmatrix.errors import InputError


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
