"""A shape as a picture: maps of depth and normals, and why pixels have none."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from numpy.typing import NDArray

from lightmatrix.pictures.style import COLOURS, STYLE, panel
from lightmatrix.pictures.transport import Picture

# Colours of kept pixels and of the tests that others failed.
_TESTS = ListedColormap(("#f2f2f2", "#404040", *COLOURS[:4]))
# The scale of depths leaves out this share of the points at either end.
_STRAY = 0.005


def shape_picture(
    depth: NDArray[np.float32],
    normals: NDArray[np.float32],
    test: NDArray[np.uint8],
    names: list[str],
    units: str | None,
) -> Picture:
    """Maps of depth (rows, cols), normals in the camera's frame, and failed tests by `names`."""
    rows, cols = depth.shape
    known = depth[np.isfinite(depth)]
    ends = np.quantile(known, [_STRAY, 1 - _STRAY]) if known.size else np.array([0.0, 1.0])
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(11, 1 + 3 * rows / cols), layout="constrained")
        maps, directions, tests = drawing.subplots(1, 3)
        # Near surfaces are bright.
        image = panel(maps, depth, "Depth", cmap="viridis_r", vmin=ends[0], vmax=ends[1])
        drawing.colorbar(image, ax=maps, label=units or "unit of the geometry", shrink=0.8)
        # Right, up and towards the camera as red, green and blue.
        colours = 0.5 + 0.5 * normals * np.array([1, -1, -1], np.float32)
        panel(directions, np.nan_to_num(colours), "Normals: right, up, near as red, green, blue")
        count = len(names)
        norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
        options: dict[str, Any] = {"cmap": _TESTS, "norm": norm, "vmin": None, "vmax": None}
        image = panel(tests, test, "Which test a pixel failed", **options)
        bar = drawing.colorbar(image, ax=tests, ticks=range(count), shrink=0.8)
        bar.set_ticklabels([name.lower().replace("_", " ") for name in names])
    return drawing
