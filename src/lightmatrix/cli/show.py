"""`lightmatrix show`: pictures of T."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described
from lightmatrix.cli.terminal import answer
from lightmatrix.errors import InputError


@described(
    view=Argument(
        metavar="VIEW",
        help="row (where the light at a camera pixel comes from), column (where the light of a "
        "projector pixel goes), dual (the scene as seen from the projector), correspondence, "
        "spectrum (singular values); clipping, gap, footprint or estimated-error of the estimate; "
        "changes, of `track`; depth, normals, layers or probability (that the depth is right) of "
        "the surface, with --geometry.",
    ),
    pixel=Argument(metavar="R,C", help="The pixel of a row or column."),
    output="A picture (.png), or numbers (.npz; .tiff, .exr and .npy for one image).",
    geometry=Option(
        metavar="GEOMETRY.json",
        help="Where camera and projector stand, for views of the surface: of `calibrate`.",
    ),
)
def show(
    scene: Store,
    view: str,
    output: Path,
    pixel: str = "",
    geometry: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Draw a row, column, map or view of T, or the surface seen.

    Pixels count from 0; the row of a colour camera has a channel too, R,C,CHANNEL.
    """
    numbers = pixel.split(",") if pixel else []
    if not all(number.isascii() and number.isdecimal() for number in numbers):
        raise InputError(f"a pixel of {pixel}", hint="write row,column, such as 20,30")
    index = map(int, numbers)
    lm.show(scene, view, *index, geometry=geometry, output=output, overwrite=overwrite)
    answer(as_json, {"output": output, "view": view}, str(output))
