"""`lightmatrix relight`: the image under a pattern that was never projected."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described
from lightmatrix.cli.terminal import answer


@described(
    pattern=Argument(metavar="PATTERN", help="An image of the projector's size."),
    output="Image: .png, .tiff, .exr or .npy.",
    exposure="Brightness factor; 1 is the unit of T.",
    gamma=Option(help="Display gamma of a PNG; 1 keeps it linear.", show_default="2.2"),
    resize="Resize the pattern to the projector.",
)
def relight(
    scene: Store,
    pattern: Path,
    output: Path,
    exposure: float = 1.0,
    gamma: float | None = None,
    resize: bool = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute the photograph under any pattern.

    The photograph is c = T p. A PNG clips at full scale; TIFF, EXR and npy keep all values. Of a
    colour projector, give the folder of red.zarr, green.zarr and blue.zarr.
    """
    image = lm.relight(
        scene, pattern, exposure=exposure, gamma=gamma, resize=resize, output=output,
        overwrite=overwrite,
    )  # fmt: skip
    clipped = float((image > 1).mean())
    note = f"; {100 * clipped:.1f} % of it is above full scale" if clipped else ""
    result = {"output": output, "mean": float(image.mean()), "clipped_share": clipped}
    answer(as_json, result, f"{output}{note}")
