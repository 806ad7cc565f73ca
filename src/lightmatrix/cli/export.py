"""`lightmatrix export`: T for other programs."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described
from lightmatrix.cli.source import rectangle
from lightmatrix.cli.terminal import answer
from lightmatrix.files.kinds import export_kind
from lightmatrix.files.writing import check_output
from lightmatrix.reprs import amount


@described(
    output=Argument(metavar="T.npz|T.mat", help="File to write."),
    # A message advises --no-dense-background.
    dense_background=Option(
        help="Spread the background over all pixels: the whole of T, but not sparse."
    ),
    crop=Option(
        metavar="ROW,COL:ROWSxCOLS",
        help="First pixel and size of the rectangle of the camera to export.",
        show_default="all",
    ),
)
def export(
    scene: Store,
    output: Path,
    dense_background: bool = False,
    crop: str | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write T for SciPy (.npz) or MATLAB (.mat).

    The file holds the sparse part of T as `scipy.sparse.load_npz` reads it. The background is
    stored separately in it, unless --dense-background adds it to the entries.
    """
    check_output(output, export_kind(output), overwrite=overwrite)
    if crop is None:
        transport = lm.open(scene)
    else:
        transport = lm.StoredTransport.open(scene).crop(*rectangle(crop))
    lm.export(output, transport, dense_background=dense_background, overwrite=overwrite)
    left_out = 0.0 if dense_background else transport.background_share
    size, note = output.stat().st_size, ""
    if left_out:
        note = f"; without the background ({100 * left_out:.1f} % of the light), which "
        note += "--dense-background adds"
    result = {"output": output, "bytes": size, "background_share_left_out": left_out}
    answer(as_json, result, f"{output}, {amount(size)}{note}")
