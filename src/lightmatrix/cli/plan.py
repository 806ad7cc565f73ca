"""`lightmatrix plan` and `patterns`: what to photograph, and the patterns as images."""

from pathlib import Path
from typing import Literal

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix import defaults
from lightmatrix.cli import options
from lightmatrix.cli.source import level_or_file
from lightmatrix.cli.terminal import answer, progress, say, show_columns, show_json
from lightmatrix.errors import InputError


@options.described(
    source=Argument(
        metavar="WHITE_FRAME|SCENE|T.npz",
        help="Photograph under a white pattern; or a scene or a truth file to simulate.",
    ),
    shape=Option(
        "--size", help="Rows x columns of the projector.", show_default=options.USUAL_SIZE
    ),
    frames=Option(
        "-k", "--count", help="Number of patterns.", show_default="as --error needs", min=2
    ),
    error="Relative error of T to aim for; decides the number of frames.",
    noise="Noise of a sample, as a share of the clip level.",
    exposure=Option(
        help="Exposure of the white frame, in any unit; the advice uses the same unit.",
        show_default="1",
    ),
    shortest="Shortest exposure of the camera, in the same unit.",
    black="Photograph under a black pattern, or the black level.",
    output="Capture folder to write: patterns/, and capture.json with the exposure of each frame. "
    "It lacks your photographs, images/.",
)
def plan(
    source: str,
    shape: str | None = None,
    frames: int | None = None,
    error: float = 0.03,
    noise: float = defaults.USUAL_NOISE,
    exposure: float | None = None,
    shortest: float | None = None,
    black: str | None = None,
    clip: options.Clip = None,
    response: options.ResponseCurve = None,
    output: Path | None = None,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Advise exposures, patterns and the number of frames.

    The advice states the error to expect and the commands to run.
    """
    with progress("rendering", "paths") as report:
        advice = lm.plan(
            source, size=None if shape is None else options.size(shape), frames=frames, error=error,
            noise=noise, exposure=exposure, shortest=shortest,
            black=None if black is None else level_or_file(black), clip=clip, response=response,
            output=output, overwrite=overwrite, progress=report,
        )  # fmt: skip
    if as_json:
        show_json(advice.as_dict())
        return
    if not advice.simulated and shape is None:
        say(f"for a projector of {options.USUAL_SIZE}; give the size of yours with --size")
    if advice.white_is_clipped:
        say(
            f"{100 * advice.white_clipped_share:.1f} % of the white frame is clipped, so its "
            "brightest light is unknown. Better take it again with a shorter exposure.",
            style="yellow",
        )
    in_own_unit = advice.simulated or exposure is not None
    show_columns(
        "Exposures",
        (
            "exposure" if in_own_unit else "exposure (white frame = 1)",
            "frames",
            "samples that will clip",
        ),
        [
            (f"{e.exposure:g}", str(e.frames), f"{100 * e.clipped_share:.1f} %")
            for e in advice.exposures
        ],
    )
    if advice.too_bright:
        say(
            f"{100 * advice.rows_that_clip_singly:.0f} % of the lit camera pixels will clip "
            "under a single projector pixel, and the errors will be several times those below. "
            "Dim the projector or close the aperture.",
            style="yellow",
        )
    kinds = {"grey": "grey levels", "fine": "all fine", "mix": "mix"}
    show_columns(
        "\nError to expect",
        ("frames", "patterns", "of T", "of relit images"),
        [
            (
                f"{e.frames} " + ("*" if e.frames == advice.frames else " "),
                kinds[e.patterns],
                ("" if e.measured else "about ") + _range(e.relative_error),
                _range(e.relighting_error),
            )
            for e in advice.expected
        ],
    )
    if advice.patterns == "random":
        say(
            "The patterns have grey levels. The light of these must be known: a projector's curve "
            "(gamma) and sharpening spoil them. Black and white ones, from "
            f"{defaults.FEWEST_BLACK_AND_WHITE} frames on, are not spoilt.",
            style="yellow",
        )
    scenes = ", ".join(advice.expected[0].scenes)
    say(
        f"* as advised. Measured on {scenes} at 128 x 128, over all rows, with advised exposures "
        "and the projector in focus. If it is blurred by 1 or 2 of its pixels, expect about 2 or 4 "
        "times the error."
    )
    say("\nCommands")
    for line in advice.commands:
        say(f"  {line}")
    if advice.simulated:
        return
    if output is not None:
        say(f"Put your photographs into {output / 'images'}, in the order of the patterns.")
        say(f"The exposure of each frame is in {output / 'capture.json'}.")
        return
    if " capture/ " in advice.commands[-1]:
        say(
            "capture/ holds patterns/, your photographs as images/, and a capture.json with the "
            "black level and the exposure of each frame: -o capture/ writes all but the "
            "photographs."
        )
    elif "--black" in advice.commands[-1]:
        say("Take the black frame at the exposure of the others.")
    if len(advice.exposures) > 1:
        say("The exposure of each frame: exposure_of_frames in --json.")


def _range(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.3f} to {pair[1]:.3f}"


Kind = Literal[
    "bernoulli", "random", "hadamard", "onepixel", "blocks", "mix", "graycode", "phase",
    "microphase",
]  # fmt: skip
Primary = Literal["red", "green", "blue", "rgb"]
Order = Literal["natural", "sequency", "random"]


@options.described(
    kind=Argument(metavar="KIND", help="Kind of patterns."),
    output="Folder to write.",
    count=Option(
        "-k",
        "--count",
        help="Number of patterns.",
        show_default=f"{defaults.USUAL_COUNT}; all for onepixel and blocks; as needed for codes",
    ),
    shape=Option("--size", help="Rows x columns of the projector."),
    density="Bernoulli and mix: share of lit pixels.",
    levels=Option(
        help="Random: grey levels. A projector's curve and sharpening spoil more than 2.",
        show_default="2 from 16 patterns on, else 3 or 4",
    ),
    mix="Mix: cell sizes and their shares of the patterns, "
    f"{defaults.MIX_EXAMPLE} (the default; all fine below {defaults.FEWEST_MIXED} patterns).",
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
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Write projection patterns as a folder of PNG files."""
    in_colour = primary == "rgb"
    if in_colour and kind != "bernoulli":
        hint = "write `lightmatrix patterns bernoulli --primary rgb`"
        raise InputError(f"{kind} patterns in rgb", hint=hint)
    if grey is not None and not in_colour:
        raise InputError("--grey without --primary rgb", hint="all of these patterns are grey")
    made: lm.PatternSet
    if in_colour:
        number = defaults.USUAL_COUNT if count is None else count
        made = lm.colour_bernoulli(
            options.size(shape), number, grey=grey, density=density, seed=seed
        )
    else:
        made = lm.make_patterns(
            kind, options.size(shape), count, density=density, levels=levels, mix=mix, order=order,
            permute=permute, block=options.size(block), inverse=inverse, period=period, seed=seed,
        )  # fmt: skip
    lm.write_patterns(
        output, made, colour=None if in_colour else primary, bit_planes=bit_planes,
        overwrite=overwrite,
    )  # fmt: skip
    result = {**made.description, "count": made.count, "digest": made.digest, "output": output}
    rows, cols = options.size(shape)
    lines = [f"{made.count} patterns ({kind}) of {rows} x {cols} pixels in {output}"]
    if rows > cols:
        lines.append(
            f"rows come first: they are for a projector in portrait, {cols} pixels wide, or for "
            "several, one above the other"
        )
    answer(as_json, result, *lines)
