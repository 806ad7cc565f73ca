"""`lightmatrix pack`: the frames of a capture in one array, chunked by tiles of camera pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.options import Json, Overwrite, ResponseCurve
from lightmatrix.cli.source import (
    Black,
    BlackExposure,
    BlackLevel,
    ClipLevel,
    Exposure,
    Folder,
    FullScale,
    Images,
    Mask,
    Mosaic,
    Patterns,
    Photographs,
    ProjectorCurve,
    White,
    source,
)
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.outputs.kinds import PACKED_CAPTURE


def pack(
    capture: Folder = None,
    photographs: Photographs = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Packed capture to write, ending in .zarr.")
    ] = Path("capture.zarr"),
    patterns: Patterns = None,
    images: Images = None,
    black: Black = None,
    black_exposure: BlackExposure = None,
    white: White = None,
    mask: Mask = None,
    black_level: BlackLevel = None,
    clip: ClipLevel = None,
    full_scale: FullScale = None,
    response: ResponseCurve = None,
    projector_response: ProjectorCurve = None,
    exposure: Exposure = None,
    mosaic: Mosaic = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Put all frames into one array, read tile by tile.

    Give a capture folder, or --patterns and --images with what else is to be said of them. The
    packed capture takes the folder's place everywhere, and is read as far as asked: a tile of
    camera pixels without the rest of the frames.
    """
    where = source(
        capture,
        photographs,
        patterns,
        images,
        black=black,
        black_exposure=black_exposure,
        white=white,
        mask=mask,
        black_level=black_level,
        clip=clip,
        full_scale=full_scale,
        response=response,
        projector_response=projector_response,
        exposure=exposure,
        mosaic=mosaic or None,
    )
    claim(output, PACKED_CAPTURE, overwrite=overwrite)
    opened = where["capture"] if "capture" in where else lm.Capture.from_folders(**where)
    with progress("packing", "frames") as step:
        lm.pack(opened, output, overwrite=overwrite, progress=step)
    size = sum(file.stat().st_size for file in output.rglob("*") if file.is_file())
    frames = lm.Capture.open(output).frames
    if as_json:
        show_json({"output": output, "frames": frames.count, "bytes": size})
    else:
        say(f"{frames.count} frames in {output}, {size / 2**20:.1f} MiB")
