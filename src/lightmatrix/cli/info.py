"""`lightmatrix info`: what a store or a capture holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Verbose
from lightmatrix.cli.terminal import say, show_json, show_table
from lightmatrix.errors import InputError
from lightmatrix.reprs import labelled


def info(
    scene: Annotated[
        Path,
        Argument(
            metavar="SCENE.zarr|CAPTURE",
            help="A store made by `estimate`, a T.npz, or a capture, packed or not.",
        ),
    ],
    pictures: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Write maps of correspondence, clipping, gaps and footprints as well.",
        ),
    ] = None,
    verbose: Verbose = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Show what a store holds: verdicts, shapes, clipping, gaps.

    For a capture: its frames, patterns, levels and exposures.
    """
    if lm.Capture.lies_at(scene):
        if pictures is not None:
            raise InputError(
                f"{scene}: is a capture, which has no maps", hint="leave out --pictures"
            )
        capture = lm.Capture.open(scene)
        if as_json:
            show_json(capture.description)
        else:
            show_table(str(scene), capture.summary())
        return
    transport = lm.open(scene)
    judged = lm.verdicts(transport)
    written = None
    if pictures is not None:
        written = lm.write_pictures(pictures, transport, overwrite=overwrite)
    if as_json:
        overall = judged.transport
        content: dict[str, Any] = {"verdict": overall.level, "sentence": overall.sentence}
        content |= {
            "verdicts": judged.as_dict(),
            **transport.summary(),
            "provenance": transport.provenance,
        }
        if written is not None:
            content["pictures"] = written
        show_json(content)
        return
    for line in judged.lines():
        say(line)
    for fault in (transport.provenance.get("rig") or {}).values():
        say(f"corrected: {fault['sentence']}")
    show_table(str(scene), labelled(transport.summary(), main_only=not verbose))
    versions = transport.provenance.get("versions")
    if verbose and isinstance(versions, Mapping) and versions:
        names = ", ".join(f"{name} {number}" for name, number in versions.items())
        say(f"made with {names}")
    if written is not None:
        say(f"pictures: {', '.join(map(str, written))}")
