"""`lm.show`: views of T as pictures or numbers, and their files.

Views of the shape need the geometry of the rig.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix import pictures
from lightmatrix.errors import InputError
from lightmatrix.files.colours import holds_colour
from lightmatrix.files.images import fill_image
from lightmatrix.files.kinds import IMAGE, NUMBERS, NUMBERS_MARK
from lightmatrix.files.writing import atomic_file, check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.pictures import maps
from lightmatrix.shape.layers import layers
from lightmatrix.shape.shape import normals_picture
from lightmatrix.shape.triangulation import triangulate
from lightmatrix.transport import store
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import ColourTransport, LightTransport
from lightmatrix.transport.store import open_colour

Numbers = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class _View:
    """A view: how to draw it, and its numbers."""

    picture: Callable[..., "pictures.style.Picture"]
    numbers: Callable[..., Numbers]
    # What it shows in place of T, found by the geometry of the rig.
    find: Callable[..., Any] | None = None


def _late(name: str) -> Callable[..., Any]:
    """A function of `pictures.transport`, which loads Matplotlib when it is called."""
    return lambda *shown: getattr(pictures.transport, name)(*shown)


def _of_map(make: Callable[[Any], maps.Map], find: Callable[..., Any] | None = None) -> _View:
    """The view of a map over the camera."""
    return _View(
        lambda shown: pictures.transport.draw_map(make(shown)),
        lambda shown: {"values": make(shown).values},
        find,
    )


def _correspondence(transport: LightTransport) -> Numbers:
    matches = correspondence(transport)
    return {"pixel": matches.pixel, "place": matches.place, "confidence": matches.confidence}


VIEWS: dict[str, _View] = {
    "row": _View(_late("draw_row"), lambda transport, *at: {"values": transport.row(*at)}),
    "column": _View(_late("draw_column"), lambda transport, *at: {"values": transport.column(*at)}),
    "dual": _View(_late("draw_dual"), lambda transport: {"values": transport.dual_image()}),
    "correspondence": _View(_late("draw_correspondence"), _correspondence),
    "spectrum": _View(_late("draw_spectrum"), _late("spectrum")),
    "clipping": _of_map(maps.clipping_map),
    "gap": _of_map(maps.gap_map),
    "footprint": _of_map(maps.footprint_map),
    "estimated-error": _of_map(maps.estimated_error_map),
    "changes": _of_map(maps.changes_map),
    "depth": _of_map(lambda shape: shape.depth_map, triangulate),
    "normals": _View(
        lambda shape: normals_picture(shape.camera_normals),
        lambda shape: {"values": shape.normals},
        triangulate,
    ),
    "probability": _of_map(lambda shape: shape.probability_map, triangulate),
    "layers": _View(lambda found: found.show(), lambda found: {"values": found.depth}, layers),
}
# Views of one row or column, and how many numbers their index may have.
_INDEXED = {"row": (2, 3), "column": (2,)}


def show(
    transport: LightTransport | ColourTransport | str | Path,
    view: str,
    *index: int,
    geometry: RigGeometry | str | Path | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> "pictures.style.Picture":
    """Draw a view of a light transport matrix, and write it or its numbers to a file.

    Parameters
    ----------
    transport : LightTransport, ColourTransport, str or Path
        T, or where `open` finds it. Of a colour projector, whose T is a folder of three stores,
        there is the view "dual", in its primaries.
    view : str
        "row" and "column" of T; "dual", the scene seen from the projector; "correspondence", the
        projector pixel that each camera pixel sees most; "spectrum", the 50 largest singular
        values; a diagnostic of an estimate: "clipping", "gap", "footprint", "estimated-error" or,
        of a `Tracker`, "changes"; or "depth" and "normals" of the surface and the "probability"
        that its depth is right, as `triangulate` finds them, and "layers", the depths of surfaces
        behind each other, as `layers` does.
    index : int
        For a row: row and column of the camera pixel and, for a colour camera, channel. For a
        column: row and column of the projector pixel. Other views have no index.
    geometry : RigGeometry, str or Path, optional
        Where camera and projector stand, or its file; only for views of the surface.
    output : str or Path, optional
        File to write: .png for the picture; .npz for its numbers (``values``, or ``pixel``,
        ``place`` and ``confidence`` of `Correspondence`); .tiff, .exr or .npy for its values as
        one image.
    overwrite : bool
        Whether an existing file may be replaced.

    Returns
    -------
    Picture
        A Matplotlib figure.

    Raises
    ------
    InputError
        On an unknown view, a wrong index, a diagnostic that the matrix does not have, or a view of
        the surface without a geometry of these images.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> picture = lm.show(known, "row", 20, 30, output="row.png")
    >>> picture = lm.show(known, "correspondence", output="map.npz")
    >>> np.load("map.npz")["place"].shape
    (64, 64, 2)
    >>> known = lm.truth("metal")
    >>> picture = lm.show(known.transport(), "depth", geometry=known.geometry, output="depth.tiff")
    """
    if view not in VIEWS:
        raise InputError(f"there is no view {view!r}", hint=f"use one of {', '.join(VIEWS)}")
    if len(index) not in _INDEXED.get(view, (0,)):
        needs = "the row and column of its pixel" if view in _INDEXED else "no pixel"
        raise InputError(
            f"the view {view} with the index {', '.join(map(str, index)) or 'of no pixel'}",
            hint=f"it takes {needs}",
        )
    find = VIEWS[view].find
    if (find is None) != (geometry is None):
        raise InputError(
            f"the view {view} {'with' if find is None else 'without'} a geometry",
            hint="depth, normals, probability and layers need the geometry of the rig, a file of "
            "`calibrate`; no other view takes one",
        )
    if output is not None:
        suffix = Path(output).suffix.lower()
        if view in ("correspondence", "spectrum") and suffix not in (".png", ".npz"):
            hint = "end the output in .png (a picture) or .npz (numbers)"
            raise InputError(f"a {view} in {output}", hint=hint)
        kind = NUMBERS if suffix == ".npz" else IMAGE
        check_output(output, kind, overwrite=overwrite)
    # A colour projector has one view.
    if isinstance(transport, str | Path):
        opened = open_colour if holds_colour(transport) else store.open
        transport = opened(transport)
    if isinstance(transport, ColourTransport) and view != "dual":
        hint = "give the matrix of one primary, such as red.zarr in the folder"
        raise InputError(f"the view {view} of a colour projector", hint=hint)
    shown = transport if find is None else find(transport, geometry)
    drawing = VIEWS[view].picture(shown, *index)
    if output is None:
        return drawing
    with atomic_file(output, kind, overwrite=overwrite) as part:
        if suffix == ".npz":
            # The mark and format version come first: even a truncated file is recognised.
            marked: dict[str, Any] = {
                NUMBERS_MARK: np.array(1),
                **VIEWS[view].numbers(shown, *index),
            }
            with part.open("wb") as stream:
                np.savez_compressed(stream, **marked)
        elif suffix != ".png":
            # A pixel may have no value, such as no depth.
            fill_image(part, VIEWS[view].numbers(shown, *index)["values"], missing=True)
        else:
            drawing.draw_file(part)
    return drawing
