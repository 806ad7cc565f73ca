"""`lightmatrix render`: the exact light transport matrix of a scene."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Seed, described, size
from lightmatrix.cli.terminal import answer, progress
from lightmatrix.defaults import USUAL_SAMPLES
from lightmatrix.files.kinds import TRUTH
from lightmatrix.files.writing import check_output


@described(
    name=Argument(metavar="SCENE", help="A scene; `lightmatrix scenes` lists them."),
    output="The T.npz file to write.",
    shape=Option("--size", help="Rows x columns of camera and projector."),
    projector=Option(
        "--projector-size", help="Rows x columns of the projector.", show_default="as --size"
    ),
    samples=Option("--spp", help="Light paths per camera pixel."),
    keep="Share of each row's energy to keep.",
    colour="Render three camera samples per pixel.",
)
def render(
    name: str,
    output: Path,
    shape: str = "128x128",
    projector: str | None = None,
    samples: int = USUAL_SAMPLES,
    keep: float = 0.999,
    colour: bool = False,
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
            name, size(shape), projector_size=None if projector is None else size(projector),
            samples=samples, seed=seed, keep=keep, colour=colour, progress=report,
        )  # fmt: skip
    truth.save(output, overwrite=overwrite)
    entries = truth.matrix.nnz / truth.matrix.shape[0]
    share = float(truth.direct_data.sum() / max(truth.matrix.sum(), 1e-30))
    result = {"output": output, "entries_per_row": entries, "direct_share": share}
    answer(
        as_json,
        {**truth.metadata, **result},
        f"{output}: {truth.matrix.shape[0]} x {truth.matrix.shape[1]}, "
        f"{entries:.0f} entries a row, {100 * share:.0f} % direct, "
        f"noise {100 * truth.metadata['noise_entries']:.1f} % of the entries' norm, "
        f"{100 * truth.metadata['noise_white']:.2f} % of the white image's",
    )
