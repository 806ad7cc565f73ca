"""`lightmatrix separate`: direct and global light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, output_option
from lightmatrix.cli.terminal import say, show_json


def separate(
    scene: Store,
    output: Annotated[Path, output_option("Folder for both matrices, their images, and maps.")],
    pattern: Annotated[
        Path | None, Option(help="Pattern of the images.", show_default="white")
    ] = None,
    epipolar: Annotated[
        bool, Option("--epipolar", help="Also write the part of T along epipolar lines.")
    ] = False,
    non_epipolar: Annotated[
        bool, Option("--non-epipolar", help="Also write the part of T off epipolar lines.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Split T into direct and global light.

    Direct light met one surface, global light several. Writes direct.zarr and global.zarr, whose
    sum is T; direct.npy and global.npy, their images; separation.png, a picture of both;
    confidence.npy and parallax.npy.
    """
    parts = lm.separate(
        scene,
        pattern=pattern,
        epipolar=epipolar,
        non_epipolar=non_epipolar,
        output=output,
        overwrite=overwrite,
    )
    direct, others = (
        float(part.sparse.data.sum(dtype=float) + part.background.sum(dtype=float))
        for part in (parts.direct, parts.global_)
    )
    share = others / max(direct + others, 1e-30)
    if as_json:
        result = {"output": output, "global_share": share}
        angle, spread = parts.geometry.direction, parts.geometry.spread
        show_json({**result, "epipolar_direction": angle, "epipolar_spread": spread})
        return
    say(f"{output}: {100 * share:.1f} % of the light is global")
