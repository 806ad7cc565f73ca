"""`lightmatrix response`: measures the curve of a camera or a projector from photographs."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, ResponseCurve, described, refuse
from lightmatrix.cli.source import level_or_file, numbers
from lightmatrix.cli.terminal import say, show_json


@described(
    photographs=Argument(
        metavar="PHOTOS",
        help="One scene at several exposures: a folder, or a stack (TIFF, npy, npz).",
    ),
    output="The curve to write: .json.",
    picture="A picture of the curve to write: .png.",
    exposure=Option(
        help="Exposure of each photograph, in any unit: 1,2,4 or a text file of them.",
        show_default="as the camera wrote it into JPEG and TIFF files",
    ),
    black=Option(
        help="Photograph with the cap on, or the raw level without light.", show_default="0"
    ),
    clip=Option(
        help="Raw level at which the camera clips.", show_default="255, 65535, or 1 for float"
    ),
    projector="The projector's curve: each photograph of another grey value, at one exposure.",
    levels=Option(
        help="The projector's grey values: 0,16,32,...,255 or a text file of them.",
        show_default="evenly from 0 to 255",
    ),
)
def response(
    photographs: Path,
    output: Path,
    picture: Path | None = None,
    exposure: str | None = None,
    black: str | None = None,
    clip: float | None = None,
    projector: bool = False,
    levels: str | None = None,
    camera: ResponseCurve = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Measure the response of a camera, or of a projector.

    Photograph a scene that does not change, with dark and bright parts, at 5 to 9 exposures, each
    about twice the one before. Give the curve to `estimate`, `check` and `plan` as --response, or
    name it in capture.json. With --projector, photograph grey values from black to white at one
    exposure (--response is the camera's curve), and use the result as --projector-response.
    """
    if projector:
        refuse({"--exposure": exposure, "--black": black}, "a projector's curve")
        grey = None if levels is None else numbers(levels, "--levels")
        ramp = lm.projector_response(
            photographs, [grey] if isinstance(grey, float) else grey, response=camera, clip=clip,
            output=output, picture=picture, overwrite=overwrite,
        )  # fmt: skip
        if as_json:
            show_json({"output": output, "picture": picture, "gamma": ramp.gamma})
            return
        say(f"{output}: the projector's gamma is about {ramp.gamma:.2f}")
        say(f"use it with: lightmatrix estimate ... --projector-response {output}")
        return
    refuse({"--levels": levels, "--response": camera}, "a camera's curve")
    measured = lm.camera_response(
        photographs, None if exposure is None else numbers(exposure, "--exposure"),
        black=None if black is None else level_or_file(black), clip=clip, output=output,
        picture=picture, overwrite=overwrite,
    )  # fmt: skip
    if as_json:
        show_json({"output": output, "picture": picture, **measured.as_dict()})
        return
    say(
        f"{output}: the camera's gamma is about {measured.gamma:.2f}; the curve is known to "
        f"{100 * max(measured.uncertainty, measured.misfit):.1f} % of full light"
    )
    # Estimates would be off by as much.
    if not measured.misfit <= 0.02:
        say(
            f"its light is up to {100 * measured.misfit:.0f} % off growing with the exposure: did "
            "the scene, the light or a setting of the camera (ISO, aperture, white balance, "
            "contrast) change between the photographs?",
            style="yellow",
        )
    if measured.channels is not None and measured.channels > 0.03:
        say(
            f"the curves of the channels differ by up to {100 * measured.channels:.0f} % of full "
            "light, and one for all is a compromise: turn colour enhancement and white balance off",
            style="yellow",
        )
    say(f"use it with: lightmatrix estimate ... --response {output}")
