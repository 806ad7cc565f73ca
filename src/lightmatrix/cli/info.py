"""`lightmatrix info`: what a store holds."""

from __future__ import annotations

from collections.abc import Mapping

import lightmatrix as lm
from lightmatrix.cli.options import Json, Store
from lightmatrix.cli.terminal import say, show_json, show_table
from lightmatrix.transport.labels import named


def info(scene: Store, as_json: Json = False) -> None:
    """Tell what a store holds: shapes, clipping, gaps."""
    transport = lm.open(scene)
    if as_json:
        show_json({**transport.summary(), "provenance": transport.provenance})
        return
    show_table(str(scene), named(transport.summary()))
    versions = transport.provenance.get("versions")
    if isinstance(versions, Mapping) and versions:
        made = ", ".join(f"{name} {number}" for name, number in versions.items())
        say(f"made with {made}")
