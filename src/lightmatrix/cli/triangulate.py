"""`lightmatrix triangulate`: the surface that the camera sees."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli.options import Json, LeastProbability, Overwrite, Tolerance, output_option
from lightmatrix.cli.terminal import say, show_json


def triangulate(
    scene: Annotated[
        Path,
        Argument(metavar="SCENE", help="A store of `estimate`, a T.npz, or an npz of `decode`."),
    ],
    geometry: Annotated[
        Path, Option(help="Where camera and projector stand: a file of `calibrate`.")
    ],
    output: Annotated[Path, output_option("Point cloud to write: .ply.")],
    depth: Annotated[Path | None, Option(help="Depth map to write: .tif, .tiff or .npy.")] = None,
    picture: Annotated[
        Path | None, Option(help="Maps of depth and normals to write: .png.")
    ] = None,
    tolerance: Tolerance = 0.01,
    least_probability: LeastProbability = 0.5,
    mesh: Annotated[
        bool, Option("--mesh", help="Write triangles between neighbouring points too.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the shape of the scene: depth, points, normals.

    Direct light can only come from a camera pixel's epipolar line on the projector; what bounced
    between surfaces lies elsewhere. Points come with normals, grey values, the uncertainty of their
    depth, and how probably it is right.
    """
    shape = lm.triangulate(
        scene,
        geometry,
        tolerance=tolerance,
        least_probability=least_probability,
        output=output,
        depth=depth,
        picture=picture,
        mesh=mesh,
        overwrite=overwrite,
    )
    summary = shape.summary()
    if as_json:
        show_json({"output": output, "depth": depth, "picture": picture, **summary})
        return
    units = f" {shape.geometry.units}" if shape.geometry.units else ""
    share = summary["points"] / shape.kept.size
    say(f"{output}: {summary['points']} points, {100 * share:.1f} % of the camera's pixels")
    if summary["points"]:
        say(
            f"median depth {summary['median_depth']:.4g}{units}, its uncertainty "
            f"{summary['median_uncertainty']:.2g}{units}"
        )
