"""`lightmatrix patterns`: writes projection patterns as a folder of images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Seed, output_option, size
from lightmatrix.cli.terminal import say, show_json
from lightmatrix.defaults import FEWEST_MIXED, MIX_EXAMPLE, USUAL_COUNT
from lightmatrix.errors import InputError

if TYPE_CHECKING:
    from lightmatrix import PatternSet

Kind = Literal[
    "bernoulli",
    "random",
    "hadamard",
    "onepixel",
    "blocks",
    "mix",
    "graycode",
    "phase",
    "microphase",
]
Primary = Literal["red", "green", "blue", "rgb"]
Order = Literal["natural", "sequency", "random"]


def patterns(
    kind: Annotated[Kind, Argument(metavar="KIND", help="Kind of patterns.")],
    output: Annotated[Path, output_option("Folder to write.")],
    count: Annotated[
        int | None,
        Option(
            "-k",
            "--count",
            help="Number of patterns.",
            show_default=f"{USUAL_COUNT}; all for onepixel and blocks; as needed for codes",
        ),
    ] = None,
    shape: Annotated[str, Option("--size", help="Rows x columns of the projector.")] = "128x128",
    density: Annotated[float, Option(help="Bernoulli and mix: share of lit pixels.")] = 0.5,
    levels: Annotated[
        int | None,
        Option(
            help="Random: grey levels. A projector's curve and sharpening spoil more than 2.",
            show_default="2 from 16 patterns on, else 3 or 4",
        ),
    ] = None,
    mix: Annotated[
        str | None,
        Option(
            help="Mix: cell sizes and their shares of the patterns, "
            f"{MIX_EXAMPLE} (the default; all fine below {FEWEST_MIXED} patterns)."
        ),
    ] = None,
    order: Annotated[Order, Option(help="Hadamard: order of the patterns.")] = "sequency",
    permute: Annotated[bool, Option(help="Hadamard: shuffle the pixels.")] = False,
    block: Annotated[str, Option(help="Blocks: rows x columns of a block.")] = "8x8",
    inverse: Annotated[
        bool, Option("--inverse", help="Graycode and phase: follow each bit by its inverse.")
    ] = False,
    period: Annotated[
        float | None,
        Option(help="Phase and microphase: projector pixels of a period.", show_default="8 and 16"),
    ] = None,
    primary: Annotated[
        Primary | None,
        Option(
            help="Primary of a colour projector; or rgb: Bernoulli patterns in all of them, each "
            "by itself.",
            show_default="white",
        ),
    ] = None,
    grey: Annotated[
        int | None,
        Option(
            help="--primary rgb: how many of the patterns are grey.",
            show_default="half, at most 16",
            min=0,
        ),
    ] = None,
    bit_planes: Annotated[
        str | None,
        Option(
            metavar="ORDER",
            help="Also write black and white patterns as bit planes of colour images, for boards "
            "with micromirrors: grb for the LightCrafter 4500.",
        ),
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write projection patterns as a folder of PNG files."""
    if mix is not None and kind != "mix":
        raise InputError(f"--mix for {kind} patterns", hint="write `lightmatrix patterns mix`")
    in_colour = primary == "rgb"
    if in_colour and kind != "bernoulli":
        raise InputError(
            f"{kind} patterns in rgb", hint="write `lightmatrix patterns bernoulli --primary rgb`"
        )
    if grey is not None and not in_colour:
        raise InputError("--grey without --primary rgb", hint="all of these patterns are grey")
    made: PatternSet
    if in_colour:
        number = USUAL_COUNT if count is None else count
        made = lm.colour_bernoulli(size(shape), number, grey=grey, density=density, seed=seed)
    else:
        made = lm.make_patterns(
            kind,
            size(shape),
            count,
            density=density,
            levels=levels,
            mix=mix,
            order=order,
            permute=permute,
            block=size(block),
            inverse=inverse,
            period=period,
            seed=seed,
        )
    lm.write_patterns(
        output,
        made,
        colour=None if in_colour else primary,
        bit_planes=bit_planes,
        overwrite=overwrite,
    )
    result = {**made.description, "count": made.count, "digest": made.digest, "output": output}
    if as_json:
        show_json(result)
    else:
        rows, cols = size(shape)
        say(f"{made.count} patterns ({kind}) of {rows} x {cols} pixels in {output}")
        if rows > cols:
            say(f"rows come first: they are for a projector in portrait, {cols} pixels wide")
