"""`lightmatrix plan`: exposures, patterns and their number, from a white frame or a scene."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import (
    USUAL_SIZE,
    Clip,
    Json,
    Overwrite,
    ResponseCurve,
    described,
    size,
)
from lightmatrix.cli.source import level_or_file
from lightmatrix.cli.terminal import progress, say, show_columns, show_json
from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE, USUAL_NOISE


@described(
    source=Argument(
        metavar="WHITE_FRAME|SCENE|T.npz",
        help="Photograph under a white pattern; or a scene or a truth file to simulate.",
    ),
    shape=Option("--size", help="Rows x columns of the projector.", show_default=USUAL_SIZE),
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
    noise: float = USUAL_NOISE,
    exposure: float | None = None,
    shortest: float | None = None,
    black: str | None = None,
    clip: Clip = None,
    response: ResponseCurve = None,
    output: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Advise exposures, patterns and the number of frames.

    The advice states the error to expect and the commands to run.
    """
    with progress("rendering", "paths") as report:
        advice = lm.plan(
            source, size=None if shape is None else size(shape), frames=frames, error=error,
            noise=noise, exposure=exposure, shortest=shortest,
            black=None if black is None else level_or_file(black), clip=clip, response=response,
            output=output, overwrite=overwrite, progress=report,
        )  # fmt: skip
    if as_json:
        show_json(advice.as_dict())
        return
    if not advice.simulated and shape is None:
        say(f"for a projector of {USUAL_SIZE}; give the size of yours with --size")
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
            f"{FEWEST_BLACK_AND_WHITE} frames on, are not spoilt.",
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
