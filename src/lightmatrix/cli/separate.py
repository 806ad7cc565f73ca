"""`lightmatrix separate`: direct and global light."""

from __future__ import annotations

from pathlib import Path

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described
from lightmatrix.cli.terminal import answer


@described(
    output="Folder for both matrices, their images, and maps.",
    pattern=Option(help="Pattern of the images.", show_default="white"),
    epipolar="Also write the part of T along epipolar lines.",
    non_epipolar="Also write the part of T off epipolar lines.",
)
def separate(
    scene: Store,
    output: Path,
    pattern: Path | None = None,
    epipolar: bool = False,
    non_epipolar: bool = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Split T into direct and global light.

    Direct light met one surface, global light several. Writes direct.zarr and global.zarr, whose
    sum is T; direct.npy and global.npy, their images; separation.png, a picture of both;
    confidence.npy and parallax.npy.
    """
    parts = lm.separate(
        scene, pattern=pattern, epipolar=epipolar, non_epipolar=non_epipolar, output=output,
        overwrite=overwrite,
    )  # fmt: skip
    direct, others = (
        float(part.sparse.data.sum(dtype=float) + part.background.sum(dtype=float))
        for part in (parts.direct, parts.global_)
    )
    share = others / max(direct + others, 1e-30)
    spread = parts.geometry.spread
    result = {"output": output, "global_share": share, "epipolar_spread": spread}
    answer(as_json, result, f"{output}: {100 * share:.1f} % of the light is global")
