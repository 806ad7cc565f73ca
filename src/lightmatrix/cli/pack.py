"""`lightmatrix pack`: writes the frames of a capture into one array."""

from __future__ import annotations

from pathlib import Path

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import answer, progress
from lightmatrix.reprs import amount


@with_source(crop=False)
@described(output="Capture folder to write.")
def pack(
    output: Path = Path("packed"),
    *,
    source: Source,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Copy a capture with all frames in one array.

    Give a capture folder; or patterns and images, each as a folder or a stack. Commands read from
    the copy only the camera pixels that they need.
    """
    # From a capture folder `pack` copies truth.npz too.
    packable = source.open() if source.folder is None else source.folder
    with progress("packing", "rows") as step:
        lm.pack(packable, output, overwrite=overwrite, progress=step)
    size = sum(file.stat().st_size for file in output.rglob("*") if file.is_file())
    frames = lm.Capture.open(output).frames
    result = {"output": output, "frames": frames.count, "bytes": size}
    answer(as_json, result, f"{frames.count} frames in {output}, {amount(size)}")
