"""`lightmatrix map`: where the light of each projector pixel goes, for other programs."""

from __future__ import annotations

from pathlib import Path

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described
from lightmatrix.cli.terminal import answer


@described(
    output="Map: .mpcdi, .exr (an STMap), .png (a pair of 16 bits), .npz (OpenCV's remap), or a "
    "folder for LightLeaks.",
    reverse="Map camera pixels to the projector instead.",
    geometry=Option(
        metavar="GEOMETRY.json", help="A file of `calibrate`, for points in LightLeaks' folder."
    ),
)
def map(
    scene: Store,
    output: Path,
    reverse: bool = False,
    geometry: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Map projector pixels to the camera, for media servers.

    For each projector pixel, the camera place that receives most of its light, to fractions of a
    pixel. A picture in the camera's view then lands where the camera sees it.
    """
    found = lm.map_projector(
        scene, geometry=geometry, reverse=reverse, output=output, overwrite=overwrite
    )
    shown = found.reverse if reverse and found.reverse is not None else found
    known = float(shown.known.mean())
    pixels = "camera" if reverse else "projector"
    text = f"{output}: {100 * known:.1f} % of the {pixels} pixels have a place"
    answer(as_json, {"output": output, "known": known}, text)
