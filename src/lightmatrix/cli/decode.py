"""`lightmatrix decode`: the correspondence of a capture under stripes."""

from __future__ import annotations

from pathlib import Path

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, described, size
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import answer, progress


@with_source(crop=False)
@described(
    output="The correspondence to write: .npz.",
    bin_projector=Option(metavar="N", help="Projector pixels to a block, such as 2 or 1x2."),
    check="Refuse photographs that contradict the code.",
)
def decode(
    output: Path = Path("correspondence.npz"),
    *,
    source: Source,
    bin_projector: str = "1",
    check: bool = True,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find what each camera pixel sees, from stripes.

    For captures under Gray code, phase shifts, micro phase shifts or any other stripes, in any
    order: the code is read from the patterns. Writes the projector pixel that each camera pixel
    sees, to fractions, with its uncertainty.
    """
    capture = source.open().bin(projector=size(bin_projector))
    with progress("decoding", "samples") as step:
        matches = lm.decode(capture, output=output, overwrite=overwrite, check=check, progress=step)
    share, known = float(matches.valid.mean()), matches.confidence[matches.valid]
    contradicted = float((known < 0.5).mean())
    facts = {"camera_shape": matches.valid.shape, "decoded_share": share}
    answer(
        as_json,
        {"output": output, **facts, "contradicted_share": contradicted},
        f"{output}: {100 * share:.1f} % of the camera's pixels see the projector; the photographs "
        f"contradict the code or the neighbours in {100 * contradicted:.1f} % of them",
    )
