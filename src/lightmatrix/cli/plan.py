"""`lightmatrix plan`: exposures, patterns and their number, from a white frame or a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from lightmatrix.cli.common import Json, out, progress, show_json, size
from lightmatrix.errors import InputError
from lightmatrix.exposures import of_frames
from lightmatrix.pattern_mix import FEWEST_MIXED, MixedPatterns, default_mix
from lightmatrix.plan import (
    DENSITY,
    USUAL_NOISE,
    WhiteFrame,
    advise_density,
    advise_exposures,
    clipped_share,
    single_clipped_share,
)
from lightmatrix.plan_table import counts, expectations, frames_for
from lightmatrix.rig import library
from lightmatrix.rig.scenes import names
from lightmatrix.rig.truth import Truth
from lightmatrix.white_frame import read_white_frame

_NAMES = {"plain": "row by row"}


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
        str | None, typer.Option("--size", help="Projector rows x columns (128x128).")
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
        typer.Option(help="Exposure of the white frame in any unit, such as ms; the answer's too."),
    ] = None,
    shortest: Annotated[
        float | None, typer.Option(help="The camera's shortest exposure, in the same unit.")
    ] = None,
    black: Annotated[
        str | None, typer.Option(help="Photograph under a black pattern, or the black level.")
    ] = None,
    clip: Annotated[float | None, typer.Option(help="Raw level at which samples clip.")] = None,
    response: Annotated[
        str | None, typer.Option(help="linear, gamma:2.2, srgb or curve:FILE.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Advise exposures, patterns and their number, with the error to expect."""
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
        projector = wanted or (128, 128)
    result = advice(white, projector, frames or frames_for(error), noise, shortest)
    result = {"source": source, **result, "commands": _commands(source, simulated, result)}
    if as_json:
        show_json(result)
    else:
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
        if source.endswith(".npz"):
            known = Truth.load(Path(source))
        else:
            known = library.truth(source, wanted or (128, 128), progress=report)
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
    if black is not None and black.replace(".", "", 1).isdecimal():
        level = float(black)
    frame = read_white_frame(source, black=level, clip=clip, response=response)
    values = frame.values[:, 0].astype(np.float64) / exposure
    return WhiteFrame(values, frame.clipped[:, 0])


def _commands(source: str, simulated: bool, result: dict[str, Any]) -> list[str]:
    rows, cols = result["projector"]
    patterns = f"patterns {result['patterns']} -k {result['frames']} --size {rows}x{cols}"
    if result["density"] != DENSITY:
        patterns += f" --density {result['density']:g}"
    lines = [f"lightmatrix {patterns} -o patterns/"]
    if simulated:
        values = [(e["exposure"], e["share"]) for e in result["exposures"]]
        shares = ",".join(f"{e:g}:{share:.6g}" for e, share in values)
        exposure = f"{values[0][0]:g}" if len(values) == 1 else shares
        lines.append(
            f"lightmatrix simulate {source} --patterns patterns/ --exposure {exposure} -o capture/"
        )
    lines.append("lightmatrix estimate capture/ -o scene.zarr")
    return lines


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
            ("> " if e["frames"] == result["frames"] else "") + str(e["frames"]),
            "mix" if e["frames"] >= FEWEST_MIXED else "all fine",
            _NAMES.get(e["estimator"], e["estimator"]) + ("" if e["measured"] else " (about)"),
            _range(e["relative_error"]),
            _range(e["relighting_error"]),
        )
    out.print(table)
    scenes = ", ".join(result["expected"][0]["scenes"])
    out.print(f"measured on {scenes} at 128 x 128, all rows, exposed as advised", highlight=False)
    out.print("\nCommands", highlight=False)
    for line in result["commands"]:
        out.print(f"  {line}", highlight=False)
    if not simulated and len(result["exposures"]) > 1:
        out.print(
            "which frame gets which exposure: --json, exposure_of_frames; write it to capture.json",
            highlight=False,
        )


def _range(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.3f} to {pair[1]:.3f}"
