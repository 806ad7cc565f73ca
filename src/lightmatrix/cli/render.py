"""`lightmatrix render`: the exact light transport matrix of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Seed, output_option, size
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.defaults import USUAL_SAMPLES
from lightmatrix.files.kinds import TRUTH
from lightmatrix.files.writing import check_output


def render(
    name: Annotated[
        str, Argument(metavar="SCENE", help="A scene; `lightmatrix scenes` lists them.")
    ],
    output: Annotated[Path, output_option("The T.npz file to write.")],
    shape: Annotated[
        str, Option("--size", help="Rows x columns of camera and projector.")
    ] = "128x128",
    projector: Annotated[
        str | None,
        Option(
            "--projector-size", help="Rows x columns of the projector.", show_default="as --size"
        ),
    ] = None,
    samples: Annotated[int, Option("--spp", help="Light paths per camera pixel.")] = USUAL_SAMPLES,
    keep: Annotated[float, Option(help="Share of each row's energy to keep.")] = 0.999,
    colour: Annotated[bool, Option(help="Render three camera samples per pixel.")] = False,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Render T of a scene; needs the extra `render`.

    One pass of path tracing gives the whole matrix, with direct and global light apart.
    """
    check_output(output, TRUTH, overwrite=overwrite)
    with progress(f"rendering {name}", "paths") as report:
        truth = lm.render(
            name,
            size(shape),
            projector_size=None if projector is None else size(projector),
            samples=samples,
            seed=seed,
            keep=keep,
            colour=colour,
            progress=report,
        )
    truth.save(output, overwrite=overwrite)
    entries = truth.matrix.nnz / truth.matrix.shape[0]
    share = float(truth.direct_data.sum() / max(truth.matrix.sum(), 1e-30))
    if as_json:
        result = {"output": output, "entries_per_row": entries, "direct_share": share}
        show_json({**truth.metadata, **result})
        return
    say(
        f"{output}: {truth.matrix.shape[0]} x {truth.matrix.shape[1]}, "
        f"{entries:.0f} entries a row, {100 * share:.0f} % direct, "
        f"noise {100 * truth.metadata['noise_entries']:.1f} % of the entries' norm, "
        f"{100 * truth.metadata['noise_white']:.2f} % of the white image's"
    )
