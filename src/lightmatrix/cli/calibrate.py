"""`lightmatrix calibrate`: the geometry of a rig from captures of a board."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.options import Json, Overwrite, size
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import GEOMETRY

if TYPE_CHECKING:
    from lightmatrix import RigCalibration


def calibrate(
    poses: Annotated[
        list[Path],
        typer.Argument(metavar="POSE...", help="A capture of each pose: patterns/ and images/."),
    ],
    board: Annotated[
        str, typer.Option(metavar="9x7", help="Inner corners of the board: squares less one.")
    ],
    square: Annotated[
        str, typer.Option(metavar="24mm", help="Side of a square, with or without a unit.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The geometry to write: .json.")
    ] = Path("rig.json"),
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Calibrate camera and projector with a board.

    Print a chessboard and mount it flat. Photograph it in 5 to 10 poses, each tilted differently,
    under a Gray code (`patterns graycode`) or under random patterns. The camera's focal length,
    distortion and place are found, and those of the projector as if it were a second camera.
    """
    side, units = _length(square)
    corners = size(board)
    claim(output, GEOMETRY, overwrite=overwrite)
    with progress("reading poses", "poses") as step:
        measured = lm.calibrate_rig(
            poses, corners, side, units=units, output=output, overwrite=overwrite, progress=step
        )
    if as_json:
        show_json({"output": output, **measured.as_dict()})
        return
    _show(measured, output)


def _length(text: str) -> tuple[float, str | None]:
    """A length such as 24mm as number and unit."""
    match = re.fullmatch(r"\s*([0-9.]+(?:e-?\d+)?)\s*([a-zA-Zµ]*)\s*", text, flags=re.ASCII)
    try:
        if match is not None:
            return float(match[1]), match[2] or None
    except ValueError:
        pass
    raise InputError(f"--square {text}", hint="give a length such as 24mm")


def _show(measured: RigCalibration, output: Path) -> None:
    rms, count = measured.geometry.rms, sum(len(pose.used) for pose in measured.poses)
    for pose in measured.poses:
        say(
            f"{pose.name}: {pose.used.sum()} of {len(pose.used)} corners, off by "
            f"{pose.rms_camera:.2f} camera pixels, {pose.rms_projector:.2f} projector pixels"
        )
    say(
        f"{output}: {measured.corners} of {count} corners in {len(measured.poses)} poses, RMS "
        f"{rms['stereo']:.2f} pixels; camera and projector are {measured.geometry.baseline:.4g} "
        f"{measured.geometry.units or 'units'} apart"
    )
    say(f"use it with: lightmatrix triangulate scene.zarr --geometry {output}")
