"""`lightmatrix layers`: several surfaces that one camera pixel sees."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, LeastProbability, Overwrite, Tolerance, output_option
from lightmatrix.cli.terminal import say, show_json


def layers(
    scene: Annotated[Path, Argument(metavar="SCENE", help="A store of `estimate`, or a T.npz.")],
    geometry: Annotated[
        Path, Option(help="Where camera and projector stand: a file of `calibrate`.")
    ],
    output: Annotated[Path, output_option("Point cloud (.ply) or image of layers (.exr).")],
    picture: Annotated[Path | None, Option(help="Maps of the layers to write: .png.")] = None,
    tolerance: Tolerance = 0.01,
    least_probability: LeastProbability = 0.5,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find surfaces behind gauze and glass, and those in mirrors.

    They come near to far, up to three a camera pixel.
    """
    found = lm.layers(
        scene,
        geometry,
        tolerance=tolerance,
        least_probability=least_probability,
        output=output,
        picture=picture,
        overwrite=overwrite,
    )
    if as_json:
        show_json({"output": output, "picture": picture, **found.summary()})
        return
    one, two, three, mirrored = found.summary().values()
    say(f"{output}: {one} pixels see one surface, {two} two, {three} three; {mirrored} by mirrors")
