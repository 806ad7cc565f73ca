"""`lightmatrix info`: what a store or a capture holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from typer import Argument

import lightmatrix as lm
from lightmatrix.cli.options import Json, Verbose, described
from lightmatrix.cli.terminal import judged_json, say, show_json, show_table
from lightmatrix.reprs import labelled


@described(
    scene=Argument(
        metavar="SCENE.zarr|CAPTURE",
        help="A store made by `estimate`, a T.npz, or a capture, packed or not.",
    )
)
def info(scene: Path, verbose: Verbose = False, as_json: Json = False) -> None:
    """Show what a store holds: verdicts, shapes, clipping, gaps.

    For a capture: its frames, patterns, levels and exposures.
    """
    if lm.Capture.lies_at(scene):
        capture = lm.Capture.open(scene)
        if as_json:
            show_json(capture.description)
        else:
            show_table(str(scene), capture.summary())
        return
    transport = lm.open(scene)
    judged = lm.verdicts(transport)
    if as_json:
        facts = {**transport.summary(), "provenance": transport.provenance}
        show_json(judged_json(judged) | facts)
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
