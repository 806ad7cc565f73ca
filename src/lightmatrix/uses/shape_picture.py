"""A shape as pictures: maps of depth and normals, and why pixels have none."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from numpy.typing import NDArray

from lightmatrix.pictures.maps import UNKNOWN, Map
from lightmatrix.pictures.style import COLOURS, STYLE, panel
from lightmatrix.pictures.transport import Picture

# Colours of kept pixels and of the tests that others failed.
_TESTS = ListedColormap(("#f2f2f2", "#404040", *COLOURS[:4]))
# The scale of depths leaves out this share of the points at either end. Chosen by eye: a few wrong
# points must not make all others alike.
_STRAY = 0.005
_NORMALS = "Normals: right, up, near as red, green, blue"


def depth_map(depth: NDArray[np.floating], units: str | None) -> Map:
    """Depth (rows, cols) as a map over the camera, near surfaces bright."""
    known = depth[np.isfinite(depth)]
    low, high = np.quantile(known, [_STRAY, 1 - _STRAY]).tolist() if known.size else (0.0, 1.0)
    # A plane that faces the camera has one depth only.
    high = max(high, low + 1e-6 * max(1.0, abs(low)))
    label = f"distance along the camera's axis, {units or 'in the unit of the geometry'}"
    return Map("depth", "Depth", label, depth.astype(np.float64), low, high, "viridis_r")


def normal_colours(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Normals (rows, cols, 3) in the camera's frame as colours in [0, 1].

    Right, up and towards the camera are red, green and blue; pixels without a normal are grey.
    """
    colours = 0.5 + 0.5 * normals.astype(np.float64) * np.array([1, -1, -1])
    known = np.isfinite(colours).all(axis=-1, keepdims=True)
    return np.asarray(np.where(known, colours, np.array(UNKNOWN)))


def shape_picture(
    depth: NDArray[np.float32],
    normals: NDArray[np.float32],
    test: NDArray[np.uint8],
    names: list[str],
    units: str | None,
) -> Picture:
    """Maps of depth (rows, cols), normals in the camera's frame, and failed tests by `names`."""
    rows, cols = depth.shape
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(11, 1 + 3 * rows / cols), layout="constrained")
        depths, directions, tests = drawing.subplots(1, 3)
        shown = depth_map(depth, units)
        options: dict[str, Any] = {"cmap": shown.colour_map, "norm": shown.norm}
        options |= {"vmin": None, "vmax": None}
        image = panel(depths, shown.shown, shown.title, **options)
        drawing.colorbar(image, ax=depths, label=shown.label, shrink=0.8)
        panel(directions, normal_colours(normals), _NORMALS)
        count = len(names)
        options |= {"cmap": _TESTS, "norm": BoundaryNorm(np.arange(count + 1) - 0.5, count)}
        image = panel(tests, test, "Which test a pixel failed", **options)
        bar = drawing.colorbar(image, ax=tests, ticks=range(count), shrink=0.8)
        bar.set_ticklabels([name.lower().replace("_", " ") for name in names])
    return drawing


def normals_picture(normals: NDArray[np.float32]) -> Picture:
    """Normals (rows, cols, 3) in the camera's frame."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(4.4, 3.6), layout="constrained")
        panel(drawing.subplots(), normal_colours(normals), _NORMALS)
    return drawing
