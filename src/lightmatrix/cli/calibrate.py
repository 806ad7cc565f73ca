"""`lightmatrix calibrate` and `response`: the geometry and the curves of a rig."""

import re
from pathlib import Path
from typing import Any, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, ResponseCurve, described, refuse, size
from lightmatrix.cli.source import level_or_file, numbers
from lightmatrix.cli.terminal import answer, progress, say, show_json
from lightmatrix.errors import InputError


@described(
    poses=Argument(
        metavar="POSE...",
        help="A capture of each pose: patterns/ and images/, or folders of captures by "
        "several cameras (camera-1, ...), of projectors in turn (projector-1, ...). With --focal, "
        "one T or file of `decode`, of a scene that is not flat.",
    ),
    board=Option(metavar="9x7", help="Inner corners of the board (squares less one), or circles."),
    square=Option(
        metavar="24mm",
        help="Side of a square, with or without a unit; or from circle to circle, of asymmetric "
        "ones from row to row.",
    ),
    kind="What is printed on the board.",
    focal="Without a board: the camera's focal length in pixels.",
    principal=Option(
        metavar="COL,ROW",
        help="Without a board: where the camera's axis passes its image.",
        show_default="the middle",
    ),
    baseline=Option(
        metavar="200mm", help="Without a board: from the camera to the projector.", show_default="1"
    ),
    diamond="Of a projector with diamond pixels (LightCrafter 4500): to which side of even rows "
    "odd rows (1, 3, ...) stand.",
    output="The geometry to write: .json, .yml or .xml (OpenCV), .colmap.",
)
def calibrate(
    poses: list[Path],
    board: str | None = None,
    square: str | None = None,
    kind: Literal["chessboard", "charuco", "circles", "asymmetric-circles"] = "chessboard",
    focal: float | None = None,
    principal: str | None = None,
    baseline: str | None = None,
    diamond: Literal["right", "left"] | None = None,
    output: Path = Path("geometry.json"),
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Calibrate cameras and projectors with a board.

    Print a board and mount it flat. Photograph it in 5 to 10 poses, each tilted differently,
    under a Gray code (`patterns graycode`) or under random patterns. The focal length, distortion
    and place of all cameras and projectors are found together; of several, each pair has a file.
    Without a board, --focal finds the projector from one scene.
    """
    stagger = {None: 0.0, "right": 0.5, "left": -0.5}[diamond]
    written: dict[str, Any] = {"output": output, "overwrite": overwrite, "stagger": stagger}
    if board is None and square is None:
        _without_board(poses, focal, principal, baseline or "1", as_json, **written)
        return
    refuse({"--focal": focal, "--principal": principal, "--baseline": baseline}, "a board")
    if board is None or square is None:
        hint = "such as --board 9x7 --square 24mm"
        raise InputError("a board takes both --board and --square", hint=hint)
    side, units = _length("--square", square)
    written |= {"kind": kind, "units": units}
    with progress("reading poses", "poses") as step:
        measured = lm.calibrate_rig(poses, size(board), side, progress=step, **written)
    rig, facts = measured.geometry, measured.as_dict()
    answer(
        as_json,
        {"output": output, "files": measured.files, **facts},
        *(
            f"{pose.name}: {pose.used.sum()} of {pose.used.size} corners, off by "
            f"{pose.rms_camera:.2f} camera pixels, {pose.rms_projector:.2f} projector pixels"
            for pose in measured.poses
        ),
        f"{', '.join(map(str, measured.files))}: {measured.corners} of {facts['of_corners']} "
        f"corners in {len(measured.poses)} poses, RMS {rig.rms['stereo']:.2f} pixels; "
        f"camera and projector are {rig.baseline:.4g} {rig.units or 'units'} apart",
        *(
            f"{device}: turned to +- {turn:.2g} degrees, placed to +- {place:.2g} "
            f"{rig.units or 'units'}"
            for device, (turn, place) in measured.standard_errors.items()
        ),
        f"use it with: lightmatrix triangulate scene.zarr --geometry {measured.files[0]}",
    )


def _without_board(
    poses: list[Path],
    focal: float | None,
    principal: str | None,
    baseline: str,
    as_json: bool,
    **written: Any,
) -> None:
    """Self-calibration from one scene."""
    if focal is None:
        raise InputError(
            "neither a board nor the camera's focal length is given",
            hint="add --board and --square, or --focal (the focal length divided by the size of a "
            "pixel) for one scene that is not flat",
        )
    if len(poses) != 1:
        hint = "give one T or one file of `decode`; or a board: --board 9x7 --square 24mm"
        raise InputError(f"--focal takes one scene, not {len(poses)}", hint=hint)
    length, units = _length("--baseline", baseline)
    axis = None
    if principal is not None:
        given = numbers(principal, "--principal")
        if not isinstance(given, list) or len(given) != 2:
            hint = "give column and row, such as 640,512"
            raise InputError(f"--principal {principal}", hint=hint)
        axis = given[0], given[1]
    rig = lm.self_calibrate(
        poses[0], focal, principal=axis, baseline=length, units=units, **written
    )
    output = written["output"]
    projector = float(rig.projector_intrinsics[0, 0])
    rms = {f"rms_{name}": value for name, value in rig.rms.items()}
    answer(
        as_json,
        {"output": output, **rms, "projector_focal_length": projector},
        f"{output}: matches lie {rig.rms['epipolar']:.2f} pixels from their epipolar lines; the "
        f"projector's focal length is {projector:.5g} +- "
        f"{rig.rms['projector_focal_length']:.2g} pixels if its axis passes the middle "
        "column to 5 % of the width",
        f"use it with: lightmatrix triangulate {poses[0]} --geometry {output} -o cloud.ply",
    )


def _length(option: str, text: str) -> tuple[float, str | None]:
    """A length such as 24mm as number and unit."""
    number = r"(?:\d+[.,]?\d*|[.,]\d+)(?:e-?\d+)?"
    match = re.fullmatch(rf"\s*({number})\s*([a-zA-Zµ]*)\s*", text, flags=re.ASCII)
    if match is None:
        raise InputError(f"{option} {text}", hint="give a length such as 24mm")
    if re.fullmatch(r"[1-9]\d{0,2},\d{3}", match[1]):
        unit, plain = match[2], match[1].replace(",", "")
        hint = f"write {float(match[1].replace(',', '.')):g}{unit} or {plain}{unit}"
        raise InputError(f"{option} {text}: is the comma a decimal point?", hint=hint)
    return float(match[1].replace(",", ".")), match[2] or None


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
