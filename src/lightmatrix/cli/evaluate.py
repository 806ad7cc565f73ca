"""`lightmatrix evaluate`: how far an estimate is from the truth."""

from __future__ import annotations

from typing import Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Json, Store
from lightmatrix.cli.terminal import progress, show_json, show_table
from lightmatrix.transport.labels import named


def evaluate(
    scene: Store,
    truth: Annotated[
        str,
        typer.Option(
            help="T.npz from `render` or `export`, a simulated capture, or a scene, rendered if "
            "need be."
        ),
    ],
    exposure: Annotated[
        float,
        typer.Option(
            help="Exposure of the capture: tells which rows clip under one projector pixel."
        ),
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Compare an estimate with the truth.

    Gives the relative error, the RMSE and the relighting error, of all rows and of some kinds.
    """
    with progress("rendering", "paths") as report:
        errors = lm.evaluate(scene, truth, exposure, progress=report).as_dict()
    if as_json:
        show_json(errors)
        return
    del errors["exposure"]
    show_table(f"{scene} against {truth}", named(errors))
