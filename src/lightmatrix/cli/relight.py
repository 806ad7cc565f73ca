"""`lightmatrix relight`: the image under a pattern that was never projected."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, output_option
from lightmatrix.cli.terminal import say, show_json


def relight(
    scene: Store,
    pattern: Annotated[Path, Argument(metavar="PATTERN", help="An image of the projector's size.")],
    output: Annotated[Path, output_option("Image: .png, .tiff, .exr or .npy.")],
    exposure: Annotated[float, Option(help="Brightness factor; 1 is the unit of T.")] = 1.0,
    gamma: Annotated[
        float | None, Option(help="Display gamma of a PNG; 1 keeps it linear.", show_default="2.2")
    ] = None,
    resize: Annotated[
        bool, Option("--resize", help="Resize the pattern to the projector.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute the photograph under any pattern.

    The photograph is c = T p. A PNG clips at full scale; TIFF, EXR and npy keep all values. Of a
    colour projector, give the folder of red.zarr, green.zarr and blue.zarr.
    """
    image = lm.relight(
        scene,
        pattern,
        exposure=exposure,
        gamma=gamma,
        resize=resize,
        output=output,
        overwrite=overwrite,
    )
    clipped, peak = float((image > 1).mean()), float(image.max())
    if as_json:
        show_json({"output": output, "mean": float(image.mean()), "clipped_share": clipped})
        return
    note = f"; {100 * clipped:.1f} % of it is above full scale" if clipped else ""
    if clipped and output.suffix.lower() == ".png":
        # Rounded down to two digits.
        keeps = exposure / peak
        unit = 10.0 ** (math.floor(math.log10(keeps)) - 1)
        most = float(f"{math.floor(keeps / unit) * unit:.2g}")
        note += f" and cut off; --exposure {most:g} keeps it all"
    say(f"{output}{note}")
