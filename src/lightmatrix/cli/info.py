"""`lightmatrix info`: what a store holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store
from lightmatrix.cli.terminal import say, show_json, show_table
from lightmatrix.transport.labels import named


def info(
    scene: Store,
    pictures: Annotated[
        Path | None,
        typer.Option(
            "--pictures",
            metavar="DIR",
            help="Write maps of correspondence, clipping, gaps and footprints as well.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Tell what a store holds: a verdict, shapes, clipping, gaps."""
    transport = lm.open(scene)
    judged = lm.verdict(transport)
    written = None
    if pictures is not None:
        written = lm.write_pictures(pictures, transport, overwrite=overwrite)
    if as_json:
        told: dict[str, Any] = {"verdict": judged.level, "sentence": judged.sentence}
        told |= {**transport.summary(), "provenance": transport.provenance}
        if written is not None:
            told["pictures"] = written
        show_json(told)
        return
    say(str(judged))
    show_table(str(scene), named(transport.summary()))
    versions = transport.provenance.get("versions")
    if isinstance(versions, Mapping) and versions:
        made = ", ".join(f"{name} {number}" for name, number in versions.items())
        say(f"made with {made}")
    if written is not None:
        say(f"pictures: {', '.join(map(str, written))}")
