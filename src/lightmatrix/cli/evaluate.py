"""`lightmatrix evaluate`: how far an estimate is from the truth."""

from __future__ import annotations

import lightmatrix as lm
from lightmatrix.cli.options import Json, Store, described
from lightmatrix.cli.terminal import progress, show_json, show_table
from lightmatrix.files.colours import holds_colour
from lightmatrix.reprs import labelled


@described(
    truth="T.npz from `render` or `export`, a simulated capture, or a scene; of a colour "
    "projector, also a folder with the captures red, green and blue.",
    exposure="Exposure of the capture; decides which rows clip under one projector pixel.",
)
def evaluate(scene: Store, truth: str, exposure: float = 1.0, as_json: Json = False) -> None:
    """Compare an estimate with the true T.

    Shows the errors of T, of relit images and of single responses, over all rows and some kinds of
    rows. For a folder of three stores, it compares the three matrices of a colour projector.
    """
    title = f"{scene} against {truth}"
    if holds_colour(scene):
        joint = lm.evaluate_colour(scene, truth, exposure)
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
