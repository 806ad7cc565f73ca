"""`lightmatrix simulate`: a scene photographed under patterns."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.options import EXPOSURES_EXAMPLE, USUAL_NOISE, Json, Overwrite, Seed
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.outputs.kinds import CAPTURE, PACKED_CAPTURE


def simulate(
    scene: Annotated[str, typer.Argument(metavar="SCENE|T.npz", help="A scene or a truth file.")],
    pattern_folder: Annotated[
        Path, typer.Option("--patterns", help="Folder made by `lightmatrix patterns`.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Capture folder to write; packed, if it ends in .zarr."
        ),
    ],
    exposure: Annotated[
        str,
        typer.Option(
            help="Exposure e: sample = min(1, e T p); or several and their shares of the frames, "
            f"{EXPOSURES_EXAMPLE}."
        ),
    ] = "0.8",
    bits: Annotated[int, typer.Option(help="Bit depth: 8, 10, 12 or 16.")] = 8,
    noise: Annotated[
        float, typer.Option(help="Read noise, standard deviation as a share of the clip level.")
    ] = USUAL_NOISE,
    shot_noise: Annotated[
        float,
        typer.Option(help="Shot noise at the clip level, standard deviation as a share of it."),
    ] = 0.0,
    black: Annotated[float, typer.Option(help="Black level in raw levels.")] = 0.0,
    blur: Annotated[float, typer.Option(help="Projector defocus, pixels (std).")] = 0.0,
    leak: Annotated[
        float, typer.Option(help="Light of a black projector pixel, share of a white one.")
    ] = 0.0,
    ambient: Annotated[
        float, typer.Option(help="Room light, share of the mean white image.")
    ] = 0.0,
    vignetting: Annotated[
        float, typer.Option(help="Share of the light lost in the camera's corners.")
    ] = 0.0,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Photograph a scene under patterns.

    The scene's matrix is known: bundled, rendered on demand, or a file. What is written is a
    capture folder to estimate from, with the matrix that was photographed as truth.npz.
    """
    packed = output.suffix.lower() == ".zarr"
    claim(output, PACKED_CAPTURE if packed else CAPTURE, overwrite=overwrite)
    with progress("simulating", "rows") as report:
        capture = lm.simulate(
            scene,
            pattern_folder,
            exposure=exposure,
            bits=bits,
            noise=noise,
            shot_noise=shot_noise,
            black_level=black,
            blur=blur,
            leak=leak,
            ambient=ambient,
            vignetting=vignetting,
            seed=seed,
            progress=report,
        )
    capture.save(output, overwrite=overwrite)
    clipped = capture.raw_clipped_share
    if as_json:
        show_json(
            {
                "output": output,
                "frames": capture.count,
                "exposures": Counter(capture.exposures.tolist()),
                "clipped_share": clipped,
            }
        )
    else:
        say(f"{capture.count} frames in {output}, {100 * clipped:.1f} % of the samples clipped")
