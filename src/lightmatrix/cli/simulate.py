"""`lightmatrix scenes`, `render`, `simulate` and `demo`: known matrices, and their photographs."""

from collections import Counter
from pathlib import Path
from typing import Literal

import typer
from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Seed, described, size
from lightmatrix.cli.terminal import answer, progress, say, show_columns, show_json
from lightmatrix.defaults import EXPOSURES_EXAMPLE, USUAL_NOISE, USUAL_SAMPLES
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CAPTURE, TRUTH
from lightmatrix.files.writing import check_output


def scenes(as_json: Json = False) -> None:
    """List the scenes that can be simulated.

    Four scenes come with the package at 64x64. Other sizes, and translucent, wall, vase and
    mirror_balls, are rendered on first use and kept, which needs the extra `render`.
    """
    listed = lm.scenes()
    if as_json:
        show_json({"scenes": [scene._asdict() for scene in listed]})
        return
    for name, description, bundled, *_ in listed:
        note = "(bundled at 64x64)" if bundled else "(rendered on first use: extra `render`)"
        say(f"{name:13}{description}  {note}")


@described(
    name=Argument(metavar="SCENE", help="A scene; `lightmatrix scenes` lists them."),
    output="The T.npz file to write.",
    shape=Option("--size", help="Rows x columns of camera and projector."),
    projector=Option(
        "--projector-size", help="Rows x columns of the projector.", show_default="as --size"
    ),
    samples=Option("--spp", help="Light paths per camera pixel."),
    keep="Share of each row's energy to keep.",
    colour="Render three camera samples per pixel.",
)
def render(
    name: str,
    output: Path,
    shape: str = "128x128",
    projector: str | None = None,
    samples: int = USUAL_SAMPLES,
    keep: float = 0.999,
    colour: bool = False,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Render T of a scene; needs the extra `render`.

    One pass of path tracing gives the whole matrix, with direct and global light apart.
    """
    check_output(output, TRUTH, overwrite=overwrite)
    with progress(f"rendering {name}", "paths") as report:
        truth = lm.render(
            name, size(shape), projector_size=None if projector is None else size(projector),
            samples=samples, seed=seed, keep=keep, colour=colour, progress=report,
        )  # fmt: skip
    truth.save(output, overwrite=overwrite)
    entries = truth.matrix.nnz / truth.matrix.shape[0]
    share = float(truth.direct_data.sum() / max(truth.matrix.sum(), 1e-30))
    result = {"output": output, "entries_per_row": entries, "direct_share": share}
    answer(
        as_json,
        {**truth.metadata, **result},
        f"{output}: {truth.matrix.shape[0]} x {truth.matrix.shape[1]}, "
        f"{entries:.0f} entries a row, {100 * share:.0f} % direct, "
        f"noise {100 * truth.metadata['noise_entries']:.1f} % of the entries' norm, "
        f"{100 * truth.metadata['noise_white']:.2f} % of the white image's",
    )


@described(
    scene=typer.Argument(
        metavar="SCENE|T.npz|procedural", help="A scene, a truth file, or a procedural scene."
    ),
    output="Capture folder to write; a packed capture if it ends in .zarr.",
    patterns="Folder made by `lightmatrix patterns`.",
    exposure="Exposure e in sample = min(1, e T p); or several with their shares of the "
    f"frames, {EXPOSURES_EXAMPLE}.",
    bits="Bit depth: 8, 10, 12 or 16.",
    noise="Read noise, standard deviation as a share of the clip level.",
    full_well=typer.Option(
        help="Electrons at the clip level, whose root is the shot noise, such as 10500.",
        show_default="no shot noise",
    ),
    black_level="Raw level without light.",
    blur="Defocus of the projector, standard deviation in pixels.",
    camera_blur="Defocus of the camera, standard deviation in its pixels.",
    leak="Light of a black projector pixel, as a share of a white one.",
    ambient="Room light, as a share of the mean white image.",
    vignetting="Share of the light lost in the camera's corners.",
    primary=typer.Option(
        help="Primary of a colour projector that shows the patterns; the camera then has "
        "three channels.",
        show_default="white",
    ),
    fault=typer.Option(
        metavar="NAME=AMOUNT",
        help="What the rig does wrong, such as shake=0.1 (camera pixels); repeat it for several: "
        "shake, creep, breathing, gain, exposure, ambient, rows, previous, torn, crosstalk, black, "
        "sharpening, camera-sharpening, camera-curve, projector-curve, dynamic-contrast, "
        "tone-mapping.",
    ),
)
def simulate(
    scene: str,
    output: Path,
    patterns: Path,
    exposure: str = "0.8",
    bits: int = 8,
    noise: float = USUAL_NOISE,
    full_well: float | None = None,
    black_level: float = 0.0,
    blur: float = 0.0,
    camera_blur: float = 0.0,
    leak: float = 0.0,
    ambient: float = 0.0,
    vignetting: float = 0.0,
    primary: Literal["red", "green", "blue"] | None = None,
    fault: list[str] | None = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Photograph a scene under patterns.

    The command writes a capture folder, with the true T beside the frames as truth.npz. Camera and
    projector have the size of the patterns; the scene `procedural` has any that fits, from 16x16 to
    thousands. Patterns for two projectors stand one above the other, 128x64 for 64x64 each; every
    camera has a folder: camera-1, camera-2.
    """
    cameras = next((one.cameras for one in lm.scenes() if one.name == scene), 1)
    several = [output / f"camera-{k}{output.suffix}" for k in range(1, cameras + 1)]
    places = several if cameras > 1 else [output]
    for place in places:
        check_output(place, CAPTURE, overwrite=overwrite)
    summaries = []
    for camera, place in enumerate(places, start=1):
        with progress("simulating", "rows") as report:
            capture = lm.simulate(
                scene, patterns, camera=camera, exposure=exposure, bits=bits, noise=noise,
                full_well=full_well, black_level=black_level, blur=blur, camera_blur=camera_blur,
                leak=leak, ambient=ambient, vignetting=vignetting,
                primary=primary, faults=_amounts(fault or []), seed=seed, progress=report,
            )  # fmt: skip
            capture.save(place, overwrite=overwrite)
        clipped, exposures = capture.raw_clipped_share, Counter(capture.exposures.tolist())
        about = {"frames": capture.count, "exposures": exposures, "clipped_share": clipped}
        summaries.append({"output": place, **about})
        if not as_json:
            say(f"{capture.count} frames in {place}, {100 * clipped:.1f} % of the samples clipped")
    if as_json:
        show_json(summaries[0] if cameras == 1 else {"output": output, "cameras": summaries})


def _amounts(faults: list[str]) -> dict[str, float]:
    amounts: dict[str, float] = {}
    for text in faults:
        name, _, amount = text.partition("=")
        try:
            number = float(amount)
        except ValueError:
            hint = "write NAME=AMOUNT, with a number such as 0.1"
            raise InputError(f"a fault of {text!r}", hint=hint) from None
        if amounts.setdefault(name, number) != number:
            raise InputError(f"{name} twice", hint="give each fault once")
    return amounts


@described(output="Folder of the report.")
def demo(
    output: Path = Path("report"), overwrite: Overwrite = False, as_json: Json = False
) -> None:
    """Simulate and estimate a scene, and write a report."""
    with progress("demo", "steps") as report:
        result = lm.demo(output, overwrite=overwrite, progress=report)
    if as_json:
        show_json({**result, "output": output})
        return
    rows, cols = result["size"]
    title = (
        f"{result['scene']}, {rows} x {cols}, {result['patterns']} Bernoulli patterns, 8 bits: "
        f"{100 * result['clipped_samples']:.0f} % of the samples clip, "
        f"{100 * result['clipping_responses']:.0f} % of the single responses"
    )
    errors = ("relative_error", "relighting_error")
    show_columns(
        title,
        ("method", "RMSE", "relative error", "relighting error"),
        [
            (each["method"], f"{each['rmse']:.4f}", *(f"{each[error]:.3f}" for error in errors))
            for each in result["methods"]
        ],
    )
    judged = lm.Verdicts.from_dict(result["report"]["verdicts"])
    say(f"default estimate: {judged.transport}")
    say(f"report: {(output / 'report.html').absolute()}")
