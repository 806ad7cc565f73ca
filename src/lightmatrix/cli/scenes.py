"""`lightmatrix scenes`: the scenes of the simulator."""

from __future__ import annotations

import lightmatrix as lm
from lightmatrix.cli.options import Json
from lightmatrix.cli.terminal import say, show_json


def scenes(as_json: Json = False) -> None:
    """List the scenes that can be simulated.

    Four scenes come with the package at 64x64. Other sizes, and translucent, wall, vase and
    mirror_balls, are rendered on first use and kept, which needs the extra `render`.
    """
    listed = lm.scenes()
    if as_json:
        show_json({"scenes": [scene._asdict() for scene in listed]})
        return
    for name, description, bundled, *_ in listed:
        note = "(bundled at 64x64)" if bundled else "(rendered on first use: extra `render`)"
        say(f"{name:13}{description}  {note}")
