"""`lightmatrix scenes`: the scenes of the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.claims import claim
from lightmatrix.cli.options import Json, Overwrite
from lightmatrix.cli.terminal import progress, say, show_json
from lightmatrix.files.kinds import THUMBNAILS


def scenes(
    thumbnails: Annotated[
        Path | None, Option(help="Draw a picture of each scene into this folder.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """List the scenes that can be simulated.

    Four scenes come with the package at 64x64. Other sizes, and translucent, wall and vase,
    are rendered on first use and kept, which needs the extra `render`.
    """
    if thumbnails is not None:
        claim(thumbnails, THUMBNAILS, overwrite=overwrite)
        with progress("drawing", "scenes") as report:
            lm.write_thumbnails(thumbnails, overwrite=overwrite, progress=report)
    listed = lm.scenes()
    if as_json:
        show_json({"scenes": [scene._asdict() for scene in listed]})
        return
    for name, description, bundled in listed:
        note = "(bundled at 64x64)" if bundled else "(rendered on first use: extra `render`)"
        say(f"{name:13}{description}  {note}")
