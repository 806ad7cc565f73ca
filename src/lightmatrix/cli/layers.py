"""`lightmatrix layers`: several surfaces that one camera pixel sees."""

from __future__ import annotations

from pathlib import Path

from typer import Argument

import lightmatrix as lm
from lightmatrix.cli.options import (
    Geometry,
    Json,
    LeastProbability,
    Overwrite,
    Tolerance,
    described,
)
from lightmatrix.cli.terminal import answer


@described(
    scene=Argument(metavar="SCENE", help="A store of `estimate`, or a T.npz."),
    output="Point cloud (.ply, .pcd, .obj, .xyz) or image of layers (.exr).",
    picture="Maps of the layers to write: .png.",
)
def layers(
    scene: Path,
    geometry: Geometry,
    output: Path,
    picture: Path | None = None,
    tolerance: Tolerance = 0.01,
    least_probability: LeastProbability = 0.5,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find surfaces behind gauze and glass, and those in mirrors.

    They come near to far, up to three a camera pixel.
    """
    found = lm.layers(
        scene, geometry, tolerance=tolerance, least_probability=least_probability, output=output,
        picture=picture, overwrite=overwrite,
    )  # fmt: skip
    one, two, three, mirrored = found.summary().values()
    answer(
        as_json,
        {"output": output, "picture": picture, **found.summary()},
        f"{output}: {one} pixels see one surface, {two} two, {three} three; {mirrored} by mirrors",
    )
