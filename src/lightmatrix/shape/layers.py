"""`lm.layers`: several surfaces that one camera pixel sees, one through the other or mirrored."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix import pictures
from lightmatrix.errors import InputError
from lightmatrix.files.extras import write_exr
from lightmatrix.files.kinds import CLOUD, IMAGE, PICTURE
from lightmatrix.files.writing import atomic_files, check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.paths import as_path
from lightmatrix.reprs import ShortRepr
from lightmatrix.shape.shape import depth_map, write_cloud
from lightmatrix.shape.spots import check_thresholds, seen_by, surface_probability
from lightmatrix.shape.triangulation import geometry_of
from lightmatrix.uses.loading import Transport, loaded


@dataclass(frozen=True, eq=False, repr=False)
class Layers(ShortRepr):
    """Up to three surfaces that each camera pixel sees: near to far, then what mirrors show.

    Parameters
    ----------
    depth, light, probability : (rows, cols, 3) float32
        Depth and probability as in `Shape`, and light under a white pattern, in units of the clip
        level; NaN where there is none. Mirrored light has no depth.
    points : (rows, cols, 3, 3) float32
        Points of the world.
    place : (rows, cols, 3, 2) float32
        Row and column of the projector pixel that lights each.
    width : (rows, cols, 3) float32
        Standard deviation of its spot on the projector, in those of a usual spot.
    mirrored : (rows, cols, 3) bool
        Whether the light came by a mirror or another surface: it lies off the epipolar line.
    geometry : RigGeometry
        Of images of these sizes.
    """

    depth: NDArray[np.float32]
    light: NDArray[np.float32]
    probability: NDArray[np.float32]
    points: NDArray[np.float32]
    place: NDArray[np.float32]
    width: NDArray[np.float32]
    mirrored: NDArray[np.bool_]
    geometry: RigGeometry

    def summary(self) -> dict[str, int]:
        """Pixels that see one, two and three surfaces, and those that see mirrored light."""
        surfaces = np.isfinite(self.depth).sum(axis=-1)
        counts = {f"pixels_with_{n}": int((surfaces == n).sum()) for n in (1, 2, 3)}
        return {**counts, "mirrored_pixels": int(self.mirrored.any(axis=-1).sum())}

    def write(self, part: Path) -> None:
        """Write points with the number of their layer, or an image of all layers (.exr)."""
        if part.suffix != ".exr":
            number = np.broadcast_to(np.arange(1, 4, dtype=np.uint8), self.depth.shape)
            write_cloud(
                part, self.points, self.light, {"probability": self.probability, "layer": number}
            )
        else:
            parts = {"Z": self.depth, "Y": self.light, "probability": self.probability}
            names = [f"layer{number}.{name}" for number in (1, 2, 3) for name in parts]
            values = np.stack([*parts.values()], axis=-1)
            write_exr(part, values.reshape(*values.shape[:2], -1), names)

    @property
    def depth_maps(self) -> "list[pictures.maps.Map]":
        """Depth of the first surface and of the one behind it, in the colours of one scale."""
        scale = depth_map(self.depth, self.geometry.units)
        titles = "Depth of the first surface", "Depth of the surface behind it"
        return [replace(scale, title=t, values=self.depth[..., k]) for k, t in enumerate(titles)]

    @property
    def mirrored_light(self) -> NDArray[np.float32]:
        """Light of mirrors and other surfaces under a white pattern, (rows, cols)."""
        return np.where(self.mirrored, self.light, np.float32(0)).sum(axis=-1)

    def show(self) -> "pictures.style.Picture":
        """A Matplotlib figure: the nearest surface, the one behind it, and what mirrors show."""
        style, maps = pictures.style, pictures.maps
        with style.figure(11, 3.4) as drawing:
            *surfaces, mirrors = drawing.subplots(1, 3)
            for axes, shown in zip(surfaces, self.depth_maps, strict=True):
                pictures.transport.draw_into(drawing, axes, shown)
            light = self.mirrored_light
            style.panel(mirrors, maps.display(light, maps.white_level(light)), "Light by mirrors")
        return drawing


def layers(
    transport: Transport,
    geometry: RigGeometry | str | Path,
    *,
    tolerance: float = 0.01,
    least_probability: float = 0.5,
    output: str | Path | None = None,
    picture: str | Path | None = None,
    overwrite: bool = False,
) -> Layers:
    """Find the surfaces that camera pixels see through each other, and what mirrors show.

    A pixel that sees a curtain, dusty glass or a mirror, and what is behind or in it, has several
    spots in its row of T. Two of them are searched beside its epipolar line, where direct light
    lies, and a third anywhere. Codes tell one place a pixel, or that of the sum.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it.
    geometry, tolerance, least_probability, picture, overwrite
        As in `triangulate`.
    output : str or Path, optional
        The file to write: a point cloud (.ply) with the number of each layer, or an image
        (.exr) with the channels Z, Y (light) and probability of layer1 to layer3.

    Returns
    -------
    Layers
        Depth, light and probability of up to three layers. Errors are those of `triangulate`, and
        MissingExtraError if an EXR file is asked for and OpenEXR is not installed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> found = lm.layers(known.transport(), known.geometry, output="metal.ply")
    >>> found.depth.shape, bool(found.mirrored.any())
    ((64, 64, 3), True)
    """
    check_thresholds(tolerance, least_probability)
    outputs = {} if picture is None else {picture: PICTURE}
    if output is not None:
        cloud = replace(CLOUD, suffixes=(*CLOUD.suffixes, ".exr"))
        outputs[output] = IMAGE if as_path(output).suffix.lower() == ".exr" else cloud
    for path, kind in outputs.items():
        check_output(path, kind, overwrite=overwrite)
    matrix = loaded(transport, 2.5)
    rig = geometry_of(matrix, geometry)
    seen = seen_by(matrix, rig)
    probability = surface_probability(seen, tolerance)
    kept = seen.direct & (probability >= least_probability)
    if outputs and not kept.any():
        raise InputError(
            "no surface is found",
            hint="is this the geometry of this rig, and is the scene lit? Or use a smaller "
            "least_probability",
        )
    # Mirrored spots lie farther off the line than where direct light is searched, in projector
    # pixels. Stray light is fainter than a tenth of its row.
    mirrored = (np.abs(seen.away) > 1.5) & (seen.share > 0.1)
    some = kept | mirrored
    order = np.argsort(np.where(kept, seen.depth, np.where(mirrored, 1e300, np.inf)), axis=1)

    def mapped(values: NDArray[Any], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        more = (*order.shape, *(1,) * (values.ndim - 2))
        shown = np.where(mask.reshape(more), values, np.nan).astype(np.float32)
        shown = np.take_along_axis(shown, order.reshape(more), axis=1)
        return shown.reshape(*seen.grid, *shown.shape[1:])

    depth, points, probable = (mapped(v, kept) for v in (seen.depth, seen.points, probability))
    light, place, width = (mapped(v, some) for v in (seen.light, seen.place, seen.width))
    by_mirror = np.isfinite(light) & np.isnan(depth)
    found = Layers(depth, light, probable, points, place, width, by_mirror, rig)
    with atomic_files(outputs, overwrite=overwrite) as parts:
        for kind, part in zip(outputs.values(), parts, strict=True):
            found.show().draw_file(part) if kind is PICTURE else found.write(part)
    return found
