"""`lightmatrix patterns`: writes projection patterns as a folder of images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Seed, described, size
from lightmatrix.cli.terminal import answer
from lightmatrix.defaults import FEWEST_MIXED, MIX_EXAMPLE, USUAL_COUNT
from lightmatrix.errors import InputError

if TYPE_CHECKING:
    from lightmatrix import PatternSet

Kind = Literal[
    "bernoulli", "random", "hadamard", "onepixel", "blocks", "mix", "graycode", "phase",
    "microphase",
]  # fmt: skip
Primary = Literal["red", "green", "blue", "rgb"]
Order = Literal["natural", "sequency", "random"]


@described(
    kind=Argument(metavar="KIND", help="Kind of patterns."),
    output="Folder to write.",
    count=Option(
        "-k",
        "--count",
        help="Number of patterns.",
        show_default=f"{USUAL_COUNT}; all for onepixel and blocks; as needed for codes",
    ),
    shape=Option("--size", help="Rows x columns of the projector."),
    density="Bernoulli and mix: share of lit pixels.",
    levels=Option(
        help="Random: grey levels. A projector's curve and sharpening spoil more than 2.",
        show_default="2 from 16 patterns on, else 3 or 4",
    ),
    mix="Mix: cell sizes and their shares of the patterns, "
    f"{MIX_EXAMPLE} (the default; all fine below {FEWEST_MIXED} patterns).",
    order="Hadamard: order of the patterns.",
    permute="Hadamard: shuffle the pixels.",
    block="Blocks: rows x columns of a block.",
    inverse="Graycode and phase: follow each bit by its inverse.",
    period=Option(
        help="Phase and microphase: projector pixels of a period.", show_default="8 and 16"
    ),
    primary=Option(
        help="Primary of a colour projector; or rgb: Bernoulli patterns in all of them, each by "
        "itself.",
        show_default="white",
    ),
    grey=Option(
        help="--primary rgb: how many of the patterns are grey.",
        show_default="half, at most 16",
        min=0,
    ),
    bit_planes=Option(
        metavar="ORDER",
        help="Also write black and white patterns as bit planes of colour images, for boards with "
        "micromirrors: grb for the LightCrafter 4500.",
    ),
)
def patterns(
    kind: Kind,
    output: Path,
    count: int | None = None,
    shape: str = "128x128",
    density: float = 0.5,
    levels: int | None = None,
    mix: str | None = None,
    order: Order = "sequency",
    permute: bool = False,
    block: str = "8x8",
    inverse: bool = False,
    period: float | None = None,
    primary: Primary | None = None,
    grey: int | None = None,
    bit_planes: str | None = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write projection patterns as a folder of PNG files."""
    in_colour = primary == "rgb"
    if in_colour and kind != "bernoulli":
        hint = "write `lightmatrix patterns bernoulli --primary rgb`"
        raise InputError(f"{kind} patterns in rgb", hint=hint)
    if grey is not None and not in_colour:
        raise InputError("--grey without --primary rgb", hint="all of these patterns are grey")
    made: PatternSet
    if in_colour:
        number = USUAL_COUNT if count is None else count
        made = lm.colour_bernoulli(size(shape), number, grey=grey, density=density, seed=seed)
    else:
        made = lm.make_patterns(
            kind, size(shape), count, density=density, levels=levels, mix=mix, order=order,
            permute=permute, block=size(block), inverse=inverse, period=period, seed=seed,
        )  # fmt: skip
    lm.write_patterns(
        output, made, colour=None if in_colour else primary, bit_planes=bit_planes,
        overwrite=overwrite,
    )  # fmt: skip
    result = {**made.description, "count": made.count, "digest": made.digest, "output": output}
    rows, cols = size(shape)
    lines = [f"{made.count} patterns ({kind}) of {rows} x {cols} pixels in {output}"]
    if rows > cols:
        lines.append(
            f"rows come first: they are for a projector in portrait, {cols} pixels wide, or for "
            "several, one above the other"
        )
    answer(as_json, result, *lines)
