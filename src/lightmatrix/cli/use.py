"""`lightmatrix info`, `evaluate`, `show`, `view`, `relight`, `separate` and `export`: uses of T."""

from collections.abc import Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, Overwrite, Store, Verbose, described
from lightmatrix.cli.source import rectangle
from lightmatrix.cli.terminal import answer, judged_json, progress, say, show_json, show_table
from lightmatrix.errors import InputError
from lightmatrix.files.colours import holds_colour
from lightmatrix.files.kinds import export_kind
from lightmatrix.files.writing import check_output
from lightmatrix.reprs import amount, labelled


@described(
    scene=Argument(
        metavar="SCENE.zarr|CAPTURE",
        help="A store made by `estimate`, a T.npz, or a capture, packed or not.",
    )
)
def info(scene: Path, verbose: Verbose = False, as_json: Json = False) -> None:
    """Show what a store holds: verdicts, shapes, clipping, gaps.

    For a capture: its frames, patterns, levels and exposures.
    """
    if lm.Capture.lies_at(scene):
        capture = lm.Capture.open(scene)
        if as_json:
            show_json(capture.description)
        else:
            show_table(str(scene), capture.summary())
        return
    transport = lm.open(scene)
    judged = lm.verdicts(transport)
    if as_json:
        facts = {**transport.summary(), "provenance": transport.provenance}
        show_json(judged_json(judged) | facts)
        return
    for line in judged.lines():
        say(line)
    for fault in (transport.provenance.get("rig") or {}).values():
        say(f"corrected: {fault['sentence']}")
    show_table(str(scene), labelled(transport.summary(), main_only=not verbose))
    versions = transport.provenance.get("versions")
    if verbose and isinstance(versions, Mapping) and versions:
        names = ", ".join(f"{name} {number}" for name, number in versions.items())
        say(f"made with {names}")


@described(
    truth="T.npz from `render` or `export`, a simulated capture, or a scene; of a colour "
    "projector, also a folder with the captures red, green and blue.",
    exposure="Exposure of the capture; decides which rows clip under one projector pixel.",
)
def evaluate(scene: Store, truth: str, exposure: float = 1.0, as_json: Json = False) -> None:
    """Compare an estimate with the true T.

    Shows the errors of T, of relit images and of single responses, over all rows and some kinds of
    rows. For a folder of three stores, it compares the three matrices of a colour projector.
    """
    if holds_colour(scene):
        joint = lm.evaluate_colour(scene, truth, exposure)
        facts, shown = joint.as_dict(), joint.table()
    else:
        with progress("rendering", "paths") as report:
            facts = lm.evaluate(scene, truth, exposure, progress=report).as_dict()
        shown = {name: value for name, value in facts.items() if name != "exposure"}
    if as_json:
        show_json(facts)
    else:
        show_table(f"{scene} against {truth}", labelled(shown))


@described(
    pattern=Argument(metavar="PATTERN", help="An image of the projector's size."),
    output="Image: .png, .tiff, .exr or .npy.",
    exposure="Brightness factor; 1 is the unit of T.",
    gamma=Option(help="Display gamma of a PNG; 1 keeps it linear.", show_default="2.2"),
    resize="Resize the pattern to the projector.",
)
def relight(
    scene: Store,
    pattern: Path,
    output: Path,
    exposure: float = 1.0,
    gamma: float | None = None,
    resize: bool = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute the photograph under any pattern.

    The photograph is c = T p. A PNG clips at full scale; TIFF, EXR and npy keep all values. Of a
    colour projector, give the folder of red.zarr, green.zarr and blue.zarr.
    """
    image = lm.relight(
        scene, pattern, exposure=exposure, gamma=gamma, resize=resize, output=output,
        overwrite=overwrite,
    )  # fmt: skip
    clipped = float((image > 1).mean())
    note = f"; {100 * clipped:.1f} % of it is above full scale" if clipped else ""
    result = {"output": output, "mean": float(image.mean()), "clipped_share": clipped}
    answer(as_json, result, f"{output}{note}")


@described(
    output="Folder for both matrices, their images, and maps.",
    pattern=Option(help="Pattern of the images.", show_default="white"),
    epipolar="Also write the part of T along epipolar lines.",
    non_epipolar="Also write the part of T off epipolar lines.",
)
def separate(
    scene: Store,
    output: Path,
    pattern: Path | None = None,
    epipolar: bool = False,
    non_epipolar: bool = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Split T into direct and global light.

    Direct light met one surface, global light several. Writes direct.zarr and global.zarr, whose
    sum is T; direct.npy and global.npy, their images; separation.png, a picture of both;
    confidence.npy and parallax.npy.
    """
    parts = lm.separate(
        scene, pattern=pattern, epipolar=epipolar, non_epipolar=non_epipolar, output=output,
        overwrite=overwrite,
    )  # fmt: skip
    direct, others = (
        float(part.sparse.data.sum(dtype=float) + part.background.sum(dtype=float))
        for part in (parts.direct, parts.global_)
    )
    share = others / max(direct + others, 1e-30)
    spread = parts.geometry.spread
    result = {"output": output, "global_share": share, "epipolar_spread": spread}
    answer(as_json, result, f"{output}: {100 * share:.1f} % of the light is global")


@described(
    output=Argument(metavar="T.npz|T.mat", help="File to write."),
    # A message advises --no-dense-background.
    dense_background=Option(
        help="Spread the background over all pixels: the whole of T, but not sparse."
    ),
    crop=Option(
        metavar="ROW,COL:ROWSxCOLS",
        help="First pixel and size of the rectangle of the camera to export.",
        show_default="all",
    ),
)
def export(
    scene: Store,
    output: Path,
    dense_background: bool = False,
    crop: str | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write T for SciPy (.npz) or MATLAB (.mat).

    The file holds the sparse part of T as `scipy.sparse.load_npz` reads it. The background is
    stored separately in it, unless --dense-background adds it to the entries.
    """
    check_output(output, export_kind(output), overwrite=overwrite)
    if crop is None:
        transport = lm.open(scene)
    else:
        transport = lm.StoredTransport.open(scene).crop(*rectangle(crop))
    lm.export(output, transport, dense_background=dense_background, overwrite=overwrite)
    left_out = 0.0 if dense_background else transport.background_share
    size, note = output.stat().st_size, ""
    if left_out:
        note = f"; without the background ({100 * left_out:.1f} % of the light), which "
        note += "--dense-background adds"
    result = {"output": output, "bytes": size, "background_share_left_out": left_out}
    answer(as_json, result, f"{output}, {amount(size)}{note}")


@described(
    view=Argument(
        metavar="VIEW",
        help="row (where the light at a camera pixel comes from), column (where the light of a "
        "projector pixel goes), dual (the scene as seen from the projector), correspondence, "
        "spectrum (singular values); clipping, gap, footprint or estimated-error of the estimate; "
        "changes, of `track`; depth, normals, layers or probability (that the depth is right) of "
        "the surface, with --geometry.",
    ),
    pixel=Argument(metavar="R,C", help="The pixel of a row or column."),
    output="A picture (.png), or numbers (.npz; .tiff, .exr and .npy for one image).",
    geometry=Option(
        metavar="GEOMETRY.json",
        help="Where camera and projector stand, for views of the surface: of `calibrate`.",
    ),
)
def show(
    scene: Store,
    view: str,
    output: Path,
    pixel: str = "",
    geometry: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Draw a row, column, map or view of T, or the surface seen.

    Pixels count from 0; the row of a colour camera has a channel too, R,C,CHANNEL.
    """
    numbers = pixel.split(",") if pixel else []
    if not all(number.isascii() and number.isdecimal() for number in numbers):
        raise InputError(f"a pixel of {pixel}", hint="write row,column, such as 20,30")
    index = map(int, numbers)
    lm.show(scene, view, *index, geometry=geometry, output=output, overwrite=overwrite)
    answer(as_json, {"output": output, "view": view}, str(output))


@described(
    export=Option(
        metavar="PAGE.html",
        help="Write the viewer and the matrix as one page that needs no server.",
    ),
    capture="The capture of the estimate, whose patterns the page then offers.",
    geometry=Option(metavar="GEOMETRY.json", help="The geometry of the rig, for layers of depth."),
    port="Port on this machine; 0 for a free one.",
    browser=Option("--browser/--no-browser", help="Open the page in the browser."),
)
def view(
    scene: Store,
    export: Path | None = None,
    capture: Path | None = None,
    geometry: Path | None = None,
    port: int = 0,
    browser: bool = True,
    overwrite: Overwrite = False,
) -> None:
    """Paint with light: show T in the browser.

    Paint on the projector, and see what the camera would photograph. Ctrl-C ends the viewer. The
    page is reachable from this machine only.
    """
    if export is not None:
        if port:
            raise InputError("--port with --export", hint="a page that is written needs none")
        lm.export_viewer(export, scene, capture=capture, geometry=geometry, overwrite=overwrite)
        say(f"{export}: open it in a browser")
        return
    shown = ExitStack()

    @cache
    def bar() -> Any:
        return shown.enter_context(progress(f"indexing the columns of {scene.name}", "entries"))

    def ready(address: str) -> None:
        shown.close()
        say(f"{address}\nCtrl-C ends it")

    with shown:
        lm.serve_viewer(
            scene, port=port, browser=browser, ready=ready, progress=lambda *step: bar()(*step),
            capture=capture, geometry=geometry,
        )  # fmt: skip
