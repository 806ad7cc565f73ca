"""`lightmatrix show`: a look at T."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store
from lightmatrix.cli.terminal import say, show_json
from lightmatrix.errors import InputError


def show(
    scene: Store,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Picture: .png. Numbers: .npz, or .tiff, .exr and .npy for one image.",
        ),
    ],
    row: Annotated[
        str | None,
        typer.Option(metavar="R,C", help="Row of T: where the light of camera pixel R,C is from."),
    ] = None,
    column: Annotated[
        str | None,
        typer.Option(metavar="R,C", help="Column of T: where projector pixel R,C's light goes."),
    ] = None,
    dual: Annotated[
        bool, typer.Option("--dual", help="The scene seen from the projector.")
    ] = False,
    correspondence: Annotated[
        bool,
        typer.Option("--correspondence", help="Projector pixel each camera pixel sees most."),
    ] = False,
    clipping: Annotated[
        bool, typer.Option("--clipping", help="Share of clipped samples, over the camera.")
    ] = False,
    gap: Annotated[
        bool, typer.Option("--gap", help="Duality gap of each row, over the camera.")
    ] = False,
    footprint: Annotated[
        bool, typer.Option("--footprint", help="Size of footprints, over the camera.")
    ] = False,
    stated_error: Annotated[
        bool, typer.Option("--stated-error", help="Error that the estimate states of each row.")
    ] = False,
    raw: Annotated[
        bool,
        typer.Option(
            "--raw", help="Correspondence as 16-bit PNG: column, row and confidence as RGB."
        ),
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Draw a row, a column, a map or a view of T.

    Give one of them. Rows and columns are counted from 0; a colour camera's row is R,C,CHANNEL.
    """
    indexed = {"row": row, "column": column}
    named = {
        "dual": dual,
        "correspondence": correspondence,
        "clipping": clipping,
        "gap": gap,
        "footprint": footprint,
        "stated-error": stated_error,
    }
    chosen = [name for name, value in indexed.items() if value is not None]
    chosen += [name for name, value in named.items() if value]
    if len(chosen) != 1:
        given = "nothing to show was" if not chosen else f"{len(chosen)} views were"
        raise InputError(
            f"{given} asked for", hint="give one of --row R,C, --column R,C, --dual, "
            "--correspondence, --clipping, --gap, --footprint, --stated-error",
        )  # fmt: skip
    view = chosen[0]
    index = _index(view, indexed.get(view))
    lm.show(scene, view, *index, output=output, raw=raw, overwrite=overwrite)
    if as_json:
        show_json({"output": output, "view": view})
        return
    say(str(output))


def _index(view: str, text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    try:
        index = tuple(int(part) for part in text.split(","))
    except ValueError:
        index = ()
    if len(index) not in (2, 3) or min(index) < 0:
        raise InputError(f"--{view} {text}", hint=f"write row,column, such as --{view} 20,30")
    return index
