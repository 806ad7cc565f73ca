"""`lightmatrix show`: pictures of T."""

from __future__ import annotations

from pathlib import Path

from typer import Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, described, output_option
from lightmatrix.cli.terminal import say, show_json
from lightmatrix.errors import InputError


@described(
    output=output_option(
        "A picture (.png), or numbers (.npz; .tiff, .exr and .npy for one image)."
    ),
    row=Option(metavar="R,C", help="Row of T: where the light at camera pixel R,C comes from."),
    column=Option(metavar="R,C", help="Column of T: where the light of projector pixel R,C goes."),
    dual=Option("--dual", help="The scene as seen from the projector."),
    correspondence=Option(
        "--correspondence", help="The projector pixel that each camera pixel sees most."
    ),
    spectrum=Option("--spectrum", help="Singular values: how low the rank of the light is."),
    clipping=Option("--clipping", help="Share of clipped samples of each camera pixel."),
    gap=Option("--gap", help="Duality gap of each row."),
    footprint=Option("--footprint", help="Size of each footprint on the projector."),
    estimated_error=Option("--estimated-error", help="Estimated error of each row."),
    depth=Option("--depth", help="Depth of the surface; needs --geometry."),
    normals=Option("--normals", help="Normals of the surface; needs --geometry."),
    geometry=Option(
        metavar="GEOMETRY.json",
        help="Where camera and projector stand, for depth and normals: a file of `calibrate`.",
    ),
    raw=Option(
        "--raw", help="Correspondence as a 16-bit PNG with column, row and confidence as RGB."
    ),
)
def show(
    scene: Store,
    output: Path,
    row: str | None = None,
    column: str | None = None,
    dual: bool = False,
    correspondence: bool = False,
    spectrum: bool = False,
    clipping: bool = False,
    gap: bool = False,
    footprint: bool = False,
    estimated_error: bool = False,
    depth: bool = False,
    normals: bool = False,
    geometry: Path | None = None,
    raw: bool = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Draw a row, column, map or view of T, or the surface seen.

    Give one of the options below. Pixels count from 0; for a colour camera, write R,C,CHANNEL.
    """
    indexed = {"row": row, "column": column}
    named = {
        "dual": dual,
        "correspondence": correspondence,
        "spectrum": spectrum,
        "clipping": clipping,
        "gap": gap,
        "footprint": footprint,
        "estimated-error": estimated_error,
        "depth": depth,
        "normals": normals,
    }
    chosen = [name for name, value in indexed.items() if value is not None]
    chosen += [name for name, value in named.items() if value]
    if len(chosen) != 1:
        count = len(chosen) or "no"
        raise InputError(
            f"{count} views are given",
            hint="give one of --row R,C, --column R,C, " + ", ".join(f"--{name}" for name in named),
        )
    view = chosen[0]
    index = _index(view, indexed.get(view))
    lm.show(scene, view, *index, geometry=geometry, output=output, raw=raw, overwrite=overwrite)
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
