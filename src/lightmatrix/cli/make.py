"""Commands that make input: patterns, scenes, rendered matrices, simulated captures."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from lightmatrix.camera.exposures import EXAMPLE as EXPOSURES_EXAMPLE
from lightmatrix.camera.exposures import of_frames, parse_exposures
from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.folder import CAPTURE, write_capture
from lightmatrix.cli.common import (
    Json,
    Overwrite,
    Seed,
    claim,
    known_truth,
    out,
    progress,
    show_json,
    size,
)
from lightmatrix.errors import InputError
from lightmatrix.patterns import mix as pattern_mix
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns, one_pixel_patterns
from lightmatrix.patterns.folder import PATTERNS, read_patterns, write_patterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.rig import library, realism
from lightmatrix.rig.renderer import render
from lightmatrix.rig.scenes import BUILDERS, names
from lightmatrix.rig.simulate import irradiance
from lightmatrix.rig.thumbnails import THUMBNAILS, write_thumbnails
from lightmatrix.rig.truth import TRUTH


class PatternKind(StrEnum):
    """Kinds of patterns that `lightmatrix patterns` makes."""

    BERNOULLI = "bernoulli"
    HADAMARD = "hadamard"
    ONE_PIXEL = "onepixel"
    BLOCKS = "blocks"
    MIX = "mix"


# Where there is no natural number of patterns.
USUAL_COUNT = 256


class HadamardOrder(StrEnum):
    """Which Hadamard patterns come first."""

    NATURAL = "natural"
    SEQUENCY = "sequency"
    RANDOM = "random"


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command("patterns")(patterns)
    app.command("scenes")(scenes)
    app.command("render")(render_scene)
    app.command("simulate")(simulate)


def patterns(
    kind: Annotated[PatternKind, typer.Argument(metavar="KIND", help="Kind of patterns.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write PNGs to.")],
    count: Annotated[
        int | None,
        typer.Option(
            "-k",
            "--count",
            help="Number of patterns.",
            show_default=f"{USUAL_COUNT}; all there are for onepixel and blocks",
        ),
    ] = None,
    shape: Annotated[str, typer.Option("--size", help="Projector rows x columns.")] = "128x128",
    density: Annotated[float, typer.Option(help="Bernoulli and mix: share of lit pixels.")] = 0.5,
    mix: Annotated[
        str | None,
        typer.Option(
            help="Mix: grids of cells lit as a whole and their shares, "
            f"{pattern_mix.EXAMPLE} (the default; all fine below {pattern_mix.FEWEST_MIXED})."
        ),
    ] = None,
    order: Annotated[
        HadamardOrder, typer.Option(help="Hadamard: which come first.")
    ] = HadamardOrder.SEQUENCY,
    permute: Annotated[bool, typer.Option(help="Hadamard: shuffle the pixels.")] = False,
    block: Annotated[str, typer.Option(help="Blocks: rows x columns of one block.")] = "8x8",
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write projection patterns as a folder of PNG files."""
    claim(output, PATTERNS, overwrite=overwrite)
    if mix is not None and kind is not PatternKind.MIX:
        raise InputError(f"--mix for {kind} patterns", hint="write `lightmatrix patterns mix`")
    projector = size(shape)
    if kind is PatternKind.MIX:
        frames = USUAL_COUNT if count is None else count
        shares = (
            pattern_mix.default_mix(projector, frames)
            if mix is None
            else pattern_mix.parse_mix(mix, projector)
        )
        made: PatternSet = pattern_mix.MixedPatterns(projector, frames, shares, density, seed)
    else:
        made = _pattern_set(kind, projector, count, density, order, permute, size(block), seed)
    write_patterns(output, made, overwrite=overwrite)
    result = {**made.description, "count": made.count, "digest": made.digest, "output": output}
    if as_json:
        show_json(result)
    else:
        rows, cols = made.shape
        out.print(f"{made.count} patterns ({kind}) of {rows} x {cols} pixels in {output}")


def _pattern_set(
    kind: PatternKind,
    shape: tuple[int, int],
    count: int | None,
    density: float,
    order: HadamardOrder,
    permute: bool,
    block: tuple[int, int],
    seed: int,
) -> PatternSet:
    if kind is PatternKind.BERNOULLI:
        return BernoulliPatterns(shape, USUAL_COUNT if count is None else count, density, seed)
    if kind is PatternKind.HADAMARD:
        wanted = USUAL_COUNT if count is None else count
        return HadamardPatterns(shape, wanted, str(order), permute, seed)
    whole = (
        one_pixel_patterns(shape) if kind is PatternKind.ONE_PIXEL else BlockPatterns(shape, block)
    )
    if count is None or count == whole.count:
        return whole
    if not 1 <= count <= whole.count:
        raise InputError(f"{count} {kind} patterns", hint=f"there are {whole.count}; leave out -k")
    chosen = np.sort(np.random.default_rng(seed).permutation(whole.count)[:count])
    return BlockPatterns(shape, whole.block, chosen)


def scenes(
    thumbnails: Annotated[
        Path | None, typer.Option(help="Folder to write a picture of each scene to.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """List the scenes of the simulated rig.

    Bundled ones come at 64x64. All else is rendered on first use and kept, which needs the extra
    `render`: other sizes, and the scenes translucent and wall.
    """
    if thumbnails is not None:
        claim(thumbnails, THUMBNAILS, overwrite=overwrite)
        with progress("drawing", "scenes") as report:
            write_thumbnails(thumbnails, overwrite=overwrite, progress=report)
    described = {name: BUILDERS[name]().description for name in names()}
    if as_json:
        show_json(
            {
                "scenes": [
                    {"name": name, "description": text, "bundled": name in library.BUNDLED}
                    for name, text in described.items()
                ]
            }
        )
        return
    for name, text in described.items():
        bundled = name in library.BUNDLED
        note = "  (bundled at 64x64)" if bundled else "  (rendered on first use: extra `render`)"
        out.print(f"{name:13}{text}{note}", highlight=False)


def render_scene(
    name: Annotated[str, typer.Argument(metavar="SCENE", help="A scene; see `scenes`.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The T.npz file to write.")],
    shape: Annotated[
        str, typer.Option("--size", help="Camera and projector, rows x columns.")
    ] = "128x128",
    projector: Annotated[
        str | None, typer.Option("--projector-size", help="Projector.", show_default="as --size")
    ] = None,
    samples: Annotated[
        int, typer.Option("--spp", help="Light paths per camera pixel.")
    ] = library.DEFAULT_SAMPLES,
    keep: Annotated[float, typer.Option(help="Share of each row's energy to keep.")] = 0.999,
    colour: Annotated[bool, typer.Option(help="Three camera samples a pixel.")] = False,
    scalar: Annotated[bool, typer.Option(help="Use the slow renderer without LLVM.")] = False,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Render a scene's T (extra `render`).

    One pass of path tracing gives the whole matrix, direct and global light apart.
    """
    claim(output, TRUTH, overwrite=overwrite)
    with progress(f"rendering {name}", "paths") as report:
        truth = render(
            name,
            size(shape),
            projector_size=None if projector is None else size(projector),
            samples=samples,
            seed=seed,
            keep=keep,
            colour=colour,
            scalar=scalar,
            progress=report,
        )
    truth.save(output, overwrite=overwrite)
    entries = truth.matrix.nnz / truth.matrix.shape[0]
    share = float(truth.direct_data.sum() / max(truth.matrix.sum(), 1e-30))
    if as_json:
        show_json(
            {
                **truth.metadata,
                "output": output,
                "entries_per_row": entries,
                "direct_share": share,
            }
        )
        return
    out.print(
        f"{output}: {truth.matrix.shape[0]} x {truth.matrix.shape[1]}, "
        f"{entries:.0f} entries a row, {100 * share:.0f} % direct, "
        f"noise {100 * truth.metadata['noise_entries']:.1f} % of the entries' norm, "
        f"{100 * truth.metadata['noise_white']:.2f} % of the white image's"
    )


def simulate(
    scene: Annotated[str, typer.Argument(metavar="SCENE|T.npz", help="A scene or a truth file.")],
    pattern_folder: Annotated[
        Path, typer.Option("--patterns", help="Folder made by `lightmatrix patterns`.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Capture folder to write.")],
    exposure: Annotated[
        str,
        typer.Option(
            help="Exposure e: sample = min(1, e T p); or several and their shares of the frames, "
            f"{EXPOSURES_EXAMPLE}."
        ),
    ] = "0.8",
    bits: Annotated[int, typer.Option(help="Bit depth: 8, 10, 12 or 16.")] = 8,
    noise: Annotated[
        float, typer.Option(help="Read noise, standard deviation as a share of the clip level.")
    ] = USUAL_NOISE,
    shot_noise: Annotated[
        float,
        typer.Option(help="Shot noise at the clip level, standard deviation as a share of it."),
    ] = 0.0,
    black: Annotated[float, typer.Option(help="Black level in raw levels.")] = 0.0,
    blur: Annotated[float, typer.Option(help="Projector defocus, pixels (std).")] = 0.0,
    leak: Annotated[
        float, typer.Option(help="Light of a black projector pixel, share of a white one.")
    ] = 0.0,
    ambient: Annotated[
        float, typer.Option(help="Room light, share of the mean white image.")
    ] = 0.0,
    vignetting: Annotated[
        float, typer.Option(help="Share of the light lost in the camera's corners.")
    ] = 0.0,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Photograph a scene under patterns.

    The scene's matrix is known: bundled, rendered on demand, or a file. What is written is a
    capture folder to estimate from.
    """
    exposures = parse_exposures(exposure)
    claim(output, CAPTURE, overwrite=overwrite)
    shown = read_patterns(pattern_folder)
    with progress("rendering", "paths") as report:
        truth = known_truth(scene, shown.shape, report)
    truth = realism.vignetting(realism.defocus(truth, blur), vignetting)
    with progress("simulating", "rows") as report:
        light = irradiance(truth.matrix, shown, progress=report)
    room = realism.ambient(truth, ambient)
    # Leaking black is affine in the pattern, so it acts on the light as it does on the patterns.
    white = np.asarray(truth.matrix.sum(axis=1), np.float32).ravel()
    dark = (leak * white + room)[:, None]
    light = (1 - leak) * light + dark
    sensor = Sensor(of_frames(exposures, shown), black, noise, shot_noise, bits)
    frames = sensor.expose(light, seed=seed)
    stack = np.ascontiguousarray(frames.T).reshape(shown.count, *truth.camera_shape)
    black_frame, longest = None, max(e for e, _ in exposures)
    if leak or ambient:
        # A frame of its own number, so that its noise is its own.
        exposed = replace(sensor, exposure=longest).expose(dark, seed=seed, first_frame=shown.count)
        black_frame = exposed.reshape(truth.camera_shape)
    write_capture(
        output,
        shown,
        stack,
        sensor=sensor,
        camera_shape=truth.camera_shape,
        overwrite=overwrite,
        black=black_frame,
        black_exposure=longest,
        provenance={"scene": scene, "seed": seed, **truth.metadata},
    )
    clipped = float((frames >= sensor.clip_level).mean())
    per_frame = np.broadcast_to(np.asarray(sensor.exposure), shown.count)
    if as_json:
        show_json(
            {
                "output": output,
                "frames": shown.count,
                "exposures": {e: int((per_frame == e).sum()) for e, _ in exposures},
                "clipped_share": clipped,
            }
        )
    else:
        out.print(f"{shown.count} frames in {output}, {100 * clipped:.1f} % of the samples clipped")
