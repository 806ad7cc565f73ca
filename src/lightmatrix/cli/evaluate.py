"""`lightmatrix evaluate`: how far an estimate is from the truth."""

from __future__ import annotations

from pathlib import Path

import lightmatrix as lm
from lightmatrix.cli.options import Blue, Green, Json, Store, described, primaries
from lightmatrix.cli.terminal import progress, show_json, show_table
from lightmatrix.files.colours import COLOURS, holds_colour
from lightmatrix.reprs import labelled


@described(
    truth="T.npz from `render` or `export`, a simulated capture, or a scene; with --green "
    "and --blue a folder with the captures red, green and blue; for the folder of a colour "
    "projector's T its simulated capture.",
    exposure="Exposure of the capture; decides which rows clip under one projector pixel.",
)
def evaluate(
    scene: Store,
    truth: str,
    green: Green = None,
    blue: Blue = None,
    exposure: float = 1.0,
    as_json: Json = False,
) -> None:
    """Compare an estimate with the true T.

    Shows the errors of T, of relit images and of single responses, over all rows and some kinds of
    rows. With --green and --blue, and for a folder of three stores, it compares the three matrices
    of a colour projector.
    """
    three = primaries(scene, green, blue)
    title = f"{scene} against {truth}"
    if three is not None or holds_colour(scene):
        known = [Path(truth) / colour for colour in COLOURS]
        joint = lm.evaluate_colour(three or scene, truth if three is None else known, exposure)
        if as_json:
            show_json(joint.as_dict())
        else:
            show_table(title, labelled(joint.table()))
        return
    with progress("rendering", "paths") as report:
        errors = lm.evaluate(scene, truth, exposure, progress=report).as_dict()
    if as_json:
        show_json(errors)
        return
    del errors["exposure"]
    show_table(title, labelled(errors))
