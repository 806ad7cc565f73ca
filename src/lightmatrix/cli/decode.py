"""`lightmatrix decode`: the correspondence of a capture under stripes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.options import Json, Overwrite, output_option
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.files.kinds import CORRESPONDENCE


@with_source(crop=False)
def decode(
    output: Annotated[Path, output_option("The correspondence to write: .npz.")] = Path(
        "correspondence.npz"
    ),
    *,
    source: Source,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find what each camera pixel sees, from stripes.

    For captures under Gray code, phase shifts, micro phase shifts or any other stripes, in any
    order: the code is read from the patterns. Writes the projector pixel that each camera pixel
    sees, to fractions, with its uncertainty.
    """
    claim(output, CORRESPONDENCE, overwrite=overwrite)
    capture = source.open()
    with progress("decoding", "samples") as step:
        matches = lm.decode(capture, output=output, overwrite=overwrite, progress=step)
    share = float(matches.valid.mean())
    if as_json:
        show_json({"output": output, "camera_shape": matches.valid.shape, "decoded_share": share})
    else:
        say(f"{output}: {100 * share:.1f} % of the camera's pixels see the projector")
