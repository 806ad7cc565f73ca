"""`lightmatrix export`: T for other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store
from lightmatrix.cli.terminal import say, show_json
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import export_kind
from lightmatrix.files.writing import check_output


def export(
    scene: Store,
    output: Annotated[Path, Argument(metavar="T.npz|T.mat", help="File to write.")],
    dense_background: Annotated[
        bool, Option(help="Spread the background over all pixels: the whole of T, but not sparse.")
    ] = False,
    region: Annotated[
        str | None,
        Option(
            metavar="ROWS,COLS",
            help="Export only these camera pixels of a store, such as 100:200,0:640.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write T for SciPy (.npz) or MATLAB (.mat).

    The file holds the sparse part of T as `scipy.sparse.load_npz` reads it. The background is
    stored separately in it, unless --dense-background adds it to the entries.
    """
    check_output(output, export_kind(output), overwrite=overwrite)
    if region is None:
        transport = lm.open(scene)
    else:
        # Only the region is read from the store.
        transport = lm.StoredTransport.open(scene).region(*_region(region))
    lm.export(output, transport, dense_background=dense_background, overwrite=overwrite)
    left_out = 0.0 if dense_background else transport.background_share
    if as_json:
        result = {"output": output, "bytes": output.stat().st_size}
        show_json({**result, "background_share_left_out": left_out})
        return
    note = ""
    if left_out:
        note = f"; without the background ({100 * left_out:.1f} % of the light), which "
        note += "--dense-background adds"
    say(f"{output}, {output.stat().st_size / 2**20:.1f} MiB{note}")


def _region(text: str) -> tuple[slice, slice]:
    """Read camera rows and columns such as 100:200,0:640."""
    match = re.fullmatch(r"(\d+):(\d+),(\d+):(\d+)", text.replace(" ", ""), flags=re.ASCII)
    if match is None:
        raise InputError(
            f"a region of {text!r}", hint="write rows and columns, such as 100:200,0:640"
        )
    top, bottom, left, right = (int(n) for n in match.groups())
    return slice(top, bottom), slice(left, right)
