"""`lightmatrix map`: where the light of each projector pixel goes, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described, refuse
from lightmatrix.cli.terminal import answer
from lightmatrix.files.colours import holds_colour, stores_within


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
    pixel. A picture in the camera's view then lands where the camera sees it. The folder of several
    projectors gives one .mpcdi with a region and a blend mask for each.
    """
    if stores_within(scene) and not holds_colour(scene):
        refuse({"--geometry": geometry, "--reverse": reverse}, "several projectors")
        several = lm.map_projectors(scene, output=output, overwrite=overwrite)
    else:
        about: dict[str, Any] = {"geometry": geometry, "reverse": reverse, "output": output}
        found = lm.map_projector(scene, **about, overwrite=overwrite)
        several = (found.reverse if reverse and found.reverse is not None else found,)
    known = [float(shown.known.mean()) for shown in several]
    pixels = "camera" if reverse else "projector"
    shares = " and ".join(f"{100 * share:.1f} %" for share in known)
    result = {"output": output, "known": known[0] if len(known) == 1 else known}
    answer(as_json, result, f"{output}: {shares} of the {pixels} pixels have a place")
