"""`lightmatrix decode`, `triangulate`, `layers` and `map`: where light comes from and goes."""

from pathlib import Path
from typing import Any

from typer import Argument, Option

import lightmatrix as lm
from lightmatrix.cli import options
from lightmatrix.cli.source import Source, with_source
from lightmatrix.cli.terminal import answer, progress
from lightmatrix.files.colours import holds_colour, stores_within


@with_source(crop=False)
@options.described(
    output="The correspondence to write: .npz.",
    bin_projector=Option(metavar="N", help="Projector pixels to a block, such as 2 or 1x2."),
    check="Refuse photographs that contradict the code.",
)
def decode(
    output: Path = Path("correspondence.npz"),
    *,
    source: Source,
    bin_projector: str = "1",
    check: bool = True,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Find what each camera pixel sees, from stripes.

    For captures under Gray code, phase shifts, micro phase shifts or any other stripes, in any
    order: the code is read from the patterns. Writes the projector pixel that each camera pixel
    sees, to fractions, with its uncertainty.
    """
    capture = source.open().bin(projector=options.size(bin_projector))
    with progress("decoding", "samples") as step:
        matches = lm.decode(capture, output=output, overwrite=overwrite, check=check, progress=step)
    share, known = float(matches.valid.mean()), matches.confidence[matches.valid]
    contradicted = float((known < 0.5).mean())
    facts = {"camera_shape": matches.valid.shape, "decoded_share": share}
    answer(
        as_json,
        {"output": output, **facts, "contradicted_share": contradicted},
        f"{output}: {100 * share:.1f} % of the camera's pixels see the projector; the photographs "
        f"contradict the code or the neighbours in {100 * contradicted:.1f} % of them",
    )


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


@options.described(
    scene=Argument(metavar="SCENE", help="A store of `estimate`, or a T.npz."),
    output="Point cloud (.ply, .pcd, .obj, .xyz) or image of layers (.exr).",
    picture="Maps of the layers to write: .png.",
)
def layers(
    scene: Path,
    geometry: options.Geometry,
    output: Path,
    picture: Path | None = None,
    tolerance: options.Tolerance = 0.01,
    least_probability: options.LeastProbability = 0.5,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Find surfaces behind gauze and glass, and those in mirrors.

    They come near to far, up to three a camera pixel.
    """
    found = lm.layers(
        scene, geometry, tolerance=tolerance, least_probability=least_probability, output=output,
        picture=picture, overwrite=overwrite,
    )  # fmt: skip
    one, two, three, mirrored = found.summary().values()
    answer(
        as_json,
        {"output": output, "picture": picture, **found.summary()},
        f"{output}: {one} pixels see one surface, {two} two, {three} three; {mirrored} by mirrors",
    )


@options.described(
    output="Map: .mpcdi, .exr (an STMap), .png (a pair of 16 bits), .npz (OpenCV's remap), or a "
    "folder for LightLeaks.",
    reverse="Map camera pixels to the projector instead.",
    geometry=Option(
        metavar="GEOMETRY.json", help="A file of `calibrate`, for points in LightLeaks' folder."
    ),
)
def map(
    scene: options.Store,
    output: Path,
    reverse: bool = False,
    geometry: Path | None = None,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Map projector pixels to the camera, for media servers.

    For each projector pixel, the camera place that receives most of its light, to fractions of a
    pixel. A picture in the camera's view then lands where the camera sees it. The folder of several
    projectors gives one .mpcdi with a region and a blend mask for each.
    """
    if stores_within(scene) and not holds_colour(scene):
        options.refuse({"--geometry": geometry, "--reverse": reverse}, "several projectors")
        several = lm.map_projectors(scene, output=output, overwrite=overwrite)
    else:
        about: dict[str, Any] = {"geometry": geometry, "reverse": reverse, "output": output}
        found = lm.map_projector(scene, **about, overwrite=overwrite)
        several = (found.reverse if reverse and found.reverse is not None else found,)
    known = [float(shown.known.mean()) for shown in several]
    pixels = "camera" if reverse else "projector"
    shares = " and ".join(f"{100 * share:.1f} %" for share in known)
    result = {"output": output, "known": known[0] if len(known) == 1 else known}
    answer(as_json, result, f"{output}: {shares} of the {pixels} pixels have a place")
