"""Commands that use a light transport matrix: info, relight, evaluate, export."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from lightmatrix import store
from lightmatrix.cli.common import (
    Json,
    Overwrite,
    claim,
    known_truth,
    out,
    progress,
    show_json,
    show_table,
)
from lightmatrix.cli.results import background_share, named, summary
from lightmatrix.errors import InputError
from lightmatrix.files.images import IMAGE, read_grey, write_image
from lightmatrix.rig.scenes import scene as find_scene
from lightmatrix.store.exchange import export_kind
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.metrics import (
    diffuse_rows,
    relative_error,
    relighting_error,
    response_rmse,
    unclipped_rows,
    unseen_patterns,
)

Store = Annotated[Path, typer.Argument(metavar="SCENE.zarr", help="A store made by `estimate`.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this file."""
    app.command("info")(info)
    app.command("relight")(relight)
    app.command("evaluate")(evaluate)
    app.command("export")(export)


def info(scene: Store, as_json: Json = False) -> None:
    """Tell what a store holds: shapes, clipping, gaps."""
    transport = store.open(scene)
    if as_json:
        show_json({**summary(transport), "provenance": transport.provenance})
        return
    show_table(str(scene), named(summary(transport)))
    versions = transport.provenance.get("versions", {})
    if versions:
        made = ", ".join(f"{name} {number}" for name, number in versions.items())
        out.print(f"made with {made}", highlight=False)


def relight(
    scene: Store,
    pattern: Annotated[
        Path, typer.Argument(metavar="PATTERN", help="Image of the projector's size.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Image: .png, .tiff or .npy.")],
    exposure: Annotated[float, typer.Option(help="Exposure e of the image.")] = 1.0,
    gamma: Annotated[
        float, typer.Option(help="Display gamma, of PNG only; 1 keeps it linear.")
    ] = 1.0,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute the image under a new pattern.

    It is c = T p for a pattern p that need not have been projected. A PNG is cut off at full
    scale; TIFF and npy keep all values.
    """
    if not exposure > 0 or not gamma > 0:
        raise InputError(
            f"an exposure of {exposure} with gamma {gamma}", hint="both must be above 0"
        )
    claim(output, IMAGE, overwrite=overwrite)
    transport = store.open(scene)
    image = exposure * transport.relight(read_grey(pattern))
    clipped, peak = float((image > 1).mean()), float(image.max())
    if output.suffix.lower() == ".png":
        image = np.clip(image, 0, 1) ** (1 / gamma)
    write_image(output, image.astype(np.float32), overwrite=overwrite)
    if as_json:
        show_json({"output": output, "mean": float(image.mean()), "clipped_share": clipped})
    else:
        note = f"; {100 * clipped:.1f} % of it is above full scale" if clipped else ""
        if clipped and output.suffix.lower() == ".png":
            note += f" and cut off; --exposure {_rounded_down(exposure / peak):g} keeps it all"
        out.print(f"{output}{note}", highlight=False)


def _rounded_down(value: float) -> float:
    """The number of two digits that is not above a positive one."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / unit) * unit:.2g}")


def evaluate(
    scene: Store,
    truth: Annotated[
        str, typer.Option(help="T.npz from `render` or `export`, or a scene, rendered if need be.")
    ],
    exposure: Annotated[
        float,
        typer.Option(
            help="Exposure of the capture: tells which rows clip under one projector pixel."
        ),
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Compare an estimate with the truth.

    Gives the relative error, the RMSE and the relighting error, of all rows and of some kinds.
    """
    if not exposure > 0:
        raise InputError(f"an exposure of {exposure}", hint="use a number above 0")
    estimate = store.open(scene)
    if not truth.lower().endswith(".npz"):
        _check_scene(scene, truth, estimate)
    with progress("rendering", "paths") as report:
        known = known_truth(truth, estimate.projector_shape, report).transport()
    if estimate.shape != known.shape:
        raise InputError(
            f"{scene} is {estimate.shape[0]} x {estimate.shape[1]}, "
            f"{truth} is {known.shape[0]} x {known.shape[1]}",
            hint="compare matrices of one rig, binned alike",
        )
    result = errors_by_rows(estimate, known, exposure)
    if as_json:
        show_json({"exposure": exposure, **result})
    else:
        show_table(f"{scene} against {truth}", named(result))


def _check_scene(store_path: Path, name: str, estimate: LightTransport) -> None:
    """Whether there is a scene of that name, at the size of the estimate."""
    find_scene(name)
    camera, projector = estimate.camera_shape, estimate.projector_shape
    if camera != projector:
        raise InputError(
            f"{store_path} has a camera of {' x '.join(map(str, camera))} and a projector of "
            f"{' x '.join(map(str, projector))}, {name} is rendered with both of one size",
            hint="give the T.npz of the same rig",
        )


def errors_by_rows(
    estimate: LightTransport, truth: LightTransport, exposure: float
) -> dict[str, float]:
    """The project's metrics over all rows, rows that do not clip singly, and diffuse rows."""
    patterns = np.stack(list(unseen_patterns(truth.projector_shape).values()))
    result = {
        "relative_error": relative_error(estimate, truth),
        "relighting_error": relighting_error(estimate, truth, patterns),
        "response_rmse": response_rmse(estimate, truth, clip_level=1 / exposure),
    }
    groups = {
        "unclipped_responses": unclipped_rows(truth, exposure),
        "diffuse": diffuse_rows(truth.sparse, truth.projector_shape),
    }
    for name, chosen in groups.items():
        result[f"share_of_rows_{name}"] = float(chosen.mean())
        if chosen.any():
            rows = np.flatnonzero(chosen)
            result[f"relative_error_{name}"] = relative_error(estimate, truth, rows)
            result[f"relighting_error_{name}"] = relighting_error(estimate, truth, patterns, rows)
    return result


def export(
    scene: Store,
    output: Annotated[Path, typer.Argument(metavar="T.npz|T.mat", help="File to write.")],
    dense_background: Annotated[
        bool,
        typer.Option(help="Spread the background over all pixels: T whole, but not sparse."),
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write T for SciPy (.npz) or MATLAB (.mat).

    The file holds the sparse part of T as `scipy.sparse.load_npz` reads it; the background is
    kept beside it unless --dense-background spreads it in.
    """
    claim(output, export_kind(output), overwrite=overwrite)
    transport = store.open(scene)
    store.export(output, transport, dense_background=dense_background, overwrite=overwrite)
    left_out = 0.0 if dense_background else background_share(transport)
    if as_json:
        result = {"output": output, "bytes": output.stat().st_size}
        show_json({**result, "background_share_left_out": left_out})
        return
    note = ""
    if left_out:
        note = f"; without the background ({100 * left_out:.1f} % of the light): "
        note += "--dense-background adds it"
    out.print(f"{output}, {output.stat().st_size / 2**20:.1f} MiB{note}", highlight=False)
