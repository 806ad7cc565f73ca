"""`lightmatrix triangulate`: the surface that the camera sees."""

from __future__ import annotations

from pathlib import Path

from typer import Argument

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.terminal import answer


@options.described(
    scene=Argument(metavar="SCENE", help="A store, a T.npz, a file of `decode`, or a map."),
    output="Point cloud to write: .ply, .pcd, .obj or .xyz.",
    depth="Depth map to write: .tif, .tiff, .npy, or .png of 16 bits in millimetres.",
    picture="Maps of depth and normals to write: .png.",
    mesh="Write triangles between neighbouring points too.",
)
def triangulate(
    scene: Path,
    geometry: options.Geometry,
    output: Path,
    depth: Path | None = None,
    picture: Path | None = None,
    tolerance: options.Tolerance = 0.01,
    least_probability: options.LeastProbability = 0.5,
    mesh: bool = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Find the shape of the scene: depth, points, normals.

    Direct light can only come from a camera pixel's epipolar line on the projector; what bounced
    between surfaces lies elsewhere. Points come with normals, grey values, the uncertainty of their
    depth, and how probably it is right. A map of another program says which projector pixel each
    camera pixel sees: an npz of x and y, NAME-x.png and NAME-y.png of 16 bits, or an EXR image.
    """
    shape = lm.triangulate(
        scene, geometry, tolerance=tolerance, least_probability=least_probability, output=output,
        depth=depth, picture=picture, mesh=mesh, overwrite=overwrite,
    )  # fmt: skip
    summary = shape.summary()
    units = f" {shape.geometry.units}" if shape.geometry.units else ""
    share = summary["points"] / shape.kept.size
    lines = [f"{output}: {summary['points']} points, {100 * share:.1f} % of the camera's pixels"]
    if summary["points"]:
        lines.append(
            f"median depth {summary['median_depth']:.4g}{units}, its uncertainty "
            f"{summary['median_uncertainty']:.2g}{units}"
        )
    answer(as_json, {"output": output, "depth": depth, "picture": picture, **summary}, *lines)
