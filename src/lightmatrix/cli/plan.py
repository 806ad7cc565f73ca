"""`lightmatrix plan`: exposures, patterns and their number, from a white frame or a scene."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from lightmatrix.camera.exposures import of_frames
from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.capture.white_frame import read_white_frame
from lightmatrix.cli.common import (
    Clip,
    Json,
    ResponseCurve,
    known_truth,
    out,
    progress,
    show_json,
    size,
)
from lightmatrix.errors import InputError
from lightmatrix.patterns.mix import FEWEST_MIXED, MixedPatterns, default_mix
from lightmatrix.planning.advice import (
    DENSITY,
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
    single_clipped_share,
)
from lightmatrix.planning.table import counts, expectations, frames_for
from lightmatrix.rig.scenes import names

_NAMES = {"plain": "row by row"}
USUAL_SIZE = (128, 128)
_ESTIMATE_FOLDER = "lightmatrix estimate capture/ -o scene.zarr"


def _size(shape: Sequence[int]) -> str:
    return "x".join(map(str, shape))


def register(app: typer.Typer) -> None:
    """Add the command of this file."""
    app.command("plan")(plan)


def plan(
    source: Annotated[
        str,
        typer.Argument(
            metavar="WHITE_FRAME|SCENE|T.npz",
            help="Photograph of a white pattern; or a scene, or a truth file, to simulate.",
        ),
    ],
    shape: Annotated[
        str | None,
        typer.Option("--size", help="Projector rows x columns.", show_default=_size(USUAL_SIZE)),
    ] = None,
    frames: Annotated[
        int | None, typer.Option("--frames", "-k", help="Frames; else as --error asks.", min=2)
    ] = None,
    error: Annotated[
        float, typer.Option(help="Relative error of T that is good enough; sets the frames.")
    ] = 0.03,
    noise: Annotated[
        float, typer.Option(help="Noise of a sample, share of the clip level.")
    ] = USUAL_NOISE,
    exposure: Annotated[
        float | None,
        typer.Option(
            help="Exposure of the white frame in any unit, such as ms; the answer's too.",
            show_default="1",
        ),
    ] = None,
    shortest: Annotated[
        float | None, typer.Option(help="The camera's shortest exposure, in the same unit.")
    ] = None,
    black: Annotated[
        str | None, typer.Option(help="Photograph under a black pattern, or the black level.")
    ] = None,
    clip: Clip = None,
    response: ResponseCurve = None,
    as_json: Json = False,
) -> None:
    """Advise exposures, patterns and frames.

    With them comes the error to expect, and the commands to run.
    """
    if not 0 < error < 1:
        raise InputError(f"an error of {error}", hint="use a relative error, such as 0.05")
    wanted = None if shape is None else size(shape)
    simulated = source.endswith(".npz") or source in names()
    if simulated:
        given: dict[str, object] = {"--exposure": exposure, "--black": black}
        given |= {"--clip": clip, "--response": response}
        odd = [name for name, value in given.items() if value is not None]
        if odd:
            raise InputError(
                f"{', '.join(odd)} with a scene", hint="they are for photographs; leave them out"
            )
        white, projector = _known(source, wanted)
    else:
        unit = 1.0 if exposure is None else exposure
        if not (np.isfinite(unit) and unit > 0):
            raise InputError(f"an exposure of {exposure}", hint="use a number above 0, such as 20")
        white = _photograph(source, black, clip, response, unit)
        projector = wanted or USUAL_SIZE
    result = advice(white, projector, frames or frames_for(error), noise, shortest)
    commands = [_make_patterns(result)]
    if simulated:
        commands += _simulate(source, result)
    else:
        commands.append(_estimate_photographs(result, black, clip, response))
    result = {"source": source, **result, "commands": commands}
    if as_json:
        show_json(result)
    else:
        if not simulated and wanted is None:
            assumed = f"for a projector of {_size(USUAL_SIZE)}; say yours with --size"
            out.print(assumed, highlight=False)
        unit_name = "exposure" if simulated or exposure else "exposure (white frame = 1)"
        _show(result, white, simulated, unit_name)


def advice(
    white: WhiteFrame,
    projector: tuple[int, int],
    frames: int,
    noise: float = USUAL_NOISE,
    shortest: float | None = None,
) -> dict[str, Any]:
    """The whole advice, JSON-ready."""
    exposures = advise_exposures(white, noise, shortest)
    density = advise_density(white, exposures)
    mix = default_mix(projector, frames)
    per_frame = np.broadcast_to(of_frames(exposures, MixedPatterns(projector, frames, mix)), frames)
    return {
        "projector": list(projector),
        "frames": frames,
        "patterns": "mix" if frames >= FEWEST_MIXED else "bernoulli",
        "density": density,
        "mix": [{"grid": list(grid), "share": share} for grid, share in mix],
        "exposures": [
            {
                "exposure": exposure,
                "share": share,
                "frames": int((per_frame == exposure).sum()),
                "clipped_share": clipped_share(white, exposure, density),
            }
            for exposure, share in exposures
        ],
        "exposure_of_frames": per_frame.tolist(),
        "white_clipped_share": white.clipped_share,
        "rows_that_clip_singly": single_clipped_share(white, exposures),
        "expected": [
            {
                "estimator": e.estimator,
                "frames": e.frames,
                "relative_error": e.relative_error,
                "relighting_error": e.relighting_error,
                "scenes": e.scenes,
                "measured": e.measured,
            }
            for count in sorted({frames, *counts()})
            for e in expectations(count)
        ],
    }


def _known(source: str, wanted: tuple[int, int] | None) -> tuple[WhiteFrame, tuple[int, int]]:
    with progress("rendering", "paths") as report:
        known = known_truth(source, wanted or USUAL_SIZE, report)
    if wanted not in (None, known.projector_shape):
        raise InputError(
            f"{source} has a projector of {known.projector_shape[0]} x {known.projector_shape[1]}",
            hint="leave --size out",
        )
    levels = known.matrix.sum(axis=1, dtype=np.float64)
    return WhiteFrame(levels, np.zeros(len(levels), bool)), known.projector_shape


def _photograph(
    source: str, black: str | None, clip: float | None, response: str | None, exposure: float
) -> WhiteFrame:
    level: str | float | None = black
    if black is not None and _is_number(black):
        level = float(black)
    frame = read_white_frame(source, black=level, clip=clip, response=response)
    values = frame.values[:, 0].astype(np.float64) / exposure
    return WhiteFrame(values, frame.clipped[:, 0])


def _is_number(black: str) -> bool:
    """Whether a black level was given, and not a file."""
    return black.replace(".", "", 1).isdecimal()


def _make_patterns(result: dict[str, Any]) -> str:
    size_of = _size(result["projector"])
    line = f"lightmatrix patterns {result['patterns']} -k {result['frames']} --size {size_of}"
    if result["density"] != DENSITY:
        line += f" --density {result['density']:g}"
    return f"{line} -o patterns/"


def _simulate(source: str, result: dict[str, Any]) -> list[str]:
    values = [(e["exposure"], e["share"]) for e in result["exposures"]]
    shares = ",".join(f"{e:g}:{share:.6g}" for e, share in values)
    exposure = f"{values[0][0]:g}" if len(values) == 1 else shares
    return [
        f"lightmatrix simulate {source} --patterns patterns/ --exposure {exposure} -o capture/",
        _ESTIMATE_FOLDER,
    ]


def _estimate_photographs(
    result: dict[str, Any], black: str | None, clip: float | None, response: str | None
) -> str:
    """From two folders; from a capture folder where only capture.json can say all."""
    if len(result["exposures"]) > 1 or (black is not None and _is_number(black)):
        return _ESTIMATE_FOLDER
    line = "lightmatrix estimate --patterns patterns/ --images photos/"
    for option, value in (("--black", black), ("--clip", clip), ("--response", response)):
        if value is not None:
            given = f"{value:g}" if isinstance(value, float) else shlex.quote(value)
            line += f" {option} {given}"
    return f"{line} -o scene.zarr"


def _show(result: dict[str, Any], white: WhiteFrame, simulated: bool, unit: str) -> None:
    if white.clipped_share > 0:
        out.print(
            f"{100 * white.clipped_share:.1f} % of the white frame is clipped, so its brightest "
            "light is not known: better take it again, darker",
            style="yellow",
        )
    table = Table(title="Exposures", title_justify="left", box=None, padding=(0, 2))
    for name in (unit, "frames", "samples that will clip"):
        table.add_column(name, justify="right")
    for e in result["exposures"]:
        table.add_row(f"{e['exposure']:g}", str(e["frames"]), f"{100 * e['clipped_share']:.1f} %")
    out.print(table)
    if result["rows_that_clip_singly"] > 0.01:
        out.print(
            f"{100 * result['rows_that_clip_singly']:.0f} % of the lit camera pixels will clip "
            "under a single projector pixel even so, and the errors will be several times those "
            "below: dim the projector or close the aperture",
            style="yellow",
        )
    table = Table(title="\nError to expect", title_justify="left", box=None, padding=(0, 2))
    for name in ("frames", "patterns", "estimate", "of T", "of relit images"):
        table.add_column(name, justify="right")
    for e in result["expected"]:
        table.add_row(
            f"{e['frames']} " + ("*" if e["frames"] == result["frames"] else " "),
            "mix" if e["frames"] >= FEWEST_MIXED else "all fine",
            _NAMES.get(e["estimator"], e["estimator"]) + ("" if e["measured"] else " (about)"),
            _range(e["relative_error"]),
            _range(e["relighting_error"]),
        )
    out.print(table)
    scenes = ", ".join(result["expected"][0]["scenes"])
    out.print(
        f"* as advised. Measured on {scenes} at 128 x 128, all rows, exposures chosen this way",
        highlight=False,
    )
    out.print("\nCommands", highlight=False)
    for line in result["commands"]:
        out.print(f"  {line}", highlight=False)
    if simulated:
        return
    if _ESTIMATE_FOLDER in result["commands"]:
        out.print(
            "capture/ holds patterns/, your photographs as images/, and a capture.json that says "
            "the black level and each frame's exposure (docs/captures.md)",
            highlight=False,
        )
    elif "--black" in result["commands"][-1]:
        out.print("take the black frame at the exposure of the others", highlight=False)
    if len(result["exposures"]) > 1:
        out.print("which frame gets which exposure: --json, exposure_of_frames", highlight=False)


def _range(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.3f} to {pair[1]:.3f}"
