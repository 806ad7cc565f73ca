"""`lightmatrix pack`: writes the frames of a capture into one array."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, output_option
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import progress, say, show_json


@with_source(crop=False)
def pack(
    output: Annotated[Path, output_option("Capture folder to write.")] = Path("packed"),
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
    if as_json:
        show_json({"output": output, "frames": frames.count, "bytes": size})
    else:
        say(f"{frames.count} frames in {output}, {size / 2**20:.1f} MiB")
