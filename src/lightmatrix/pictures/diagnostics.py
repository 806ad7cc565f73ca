"""Pictures of how good a light transport matrix is, and of what its rows know of themselves."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lightmatrix.pictures.maps import (
    Map,
    clipping_map,
    correspondence_maps,
    footprint_map,
    gap_map,
    stated_error_map,
)
from lightmatrix.pictures.style import STYLE, panel
from lightmatrix.pictures.transport import Picture
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import LightTransport

# Lines on a map of projector rows or columns: so many of them cross the projector.
_LINES = 8


def show_clipping(transport: LightTransport) -> Picture:
    """Picture of how many of each camera pixel's samples clipped.

    Parameters
    ----------
    transport : LightTransport
        An estimate, whose diagnostics say it.

    Returns
    -------
    Picture
        A Matplotlib figure; of a colour camera, the channel that clipped most.

    Raises
    ------
    InputError
        If the matrix does not come from a capture.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure=2)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=5)
    >>> lm.show_clipping(estimate).savefig("clipping.png")
    """
    return draw(clipping_map(transport))


def show_gaps(transport: LightTransport) -> Picture:
    """Picture of the relative duality gap of each row: how far from its optimum it can be.

    Parameters
    ----------
    transport : LightTransport
        An estimate of a solver that certifies its rows, such as active-set.

    Returns
    -------
    Picture
        A Matplotlib figure; rows without a gap are grey. Of a colour camera, the largest gap.

    Raises
    ------
    InputError
        If no row has a gap.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8), exposure=2)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=5)
    >>> lm.show_gaps(estimate).savefig("gaps.png")
    """
    return draw(gap_map(transport))


def show_footprints(transport: LightTransport) -> Picture:
    """Picture of the size of each camera pixel's footprint: what is out of focus.

    Parameters
    ----------
    transport : LightTransport
        An estimate that measured its footprints.

    Returns
    -------
    Picture
        A Matplotlib figure, in projector pixels; of a colour camera, the largest of its channels.

    Raises
    ------
    InputError
        If the estimate did not measure them.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_footprints(lm.open("scene.zarr")).savefig("footprints.png")  # doctest: +SKIP
    """
    return draw(footprint_map(transport))


def show_stated_errors(transport: LightTransport) -> Picture:
    """Picture of the relative error that an estimate states of each of its rows.

    Parameters
    ----------
    transport : LightTransport
        An estimate that states its errors.

    Returns
    -------
    Picture
        A Matplotlib figure; of a colour camera, the largest error of its channels.

    Raises
    ------
    InputError
        If the estimate states none.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_stated_errors(lm.open("scene.zarr")).savefig("errors.png")  # doctest: +SKIP
    """
    return draw(stated_error_map(transport))


def show_correspondence(transport: LightTransport) -> Picture:
    """Picture of which projector pixel each camera pixel sees most, and how sure that is.

    Parameters
    ----------
    transport : LightTransport

    Returns
    -------
    Picture
        A Matplotlib figure of three maps: projector row, projector column, and the share of the
        light that comes from there. `correspondence` gives the numbers.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_correspondence(lm.truth("metal").transport()).savefig("correspondence.png")
    """
    maps = correspondence_maps(correspondence(transport))
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(10.2, 3.4), layout="constrained")
        axes = drawing.subplots(1, 3)
        for place, shown in zip(axes, maps, strict=True):
            _draw_into(drawing, place, shown)
        for place, shown in zip(axes[:2], maps[:2], strict=True):
            _draw_lines(place, shown)
    return drawing


def draw(shown: Map) -> Picture:
    """A map with its title and the scale of its colours."""
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(4.4, 3.6), layout="constrained")
        _draw_into(drawing, drawing.subplots(), shown)
    return drawing


def _draw_into(drawing: Figure, axes: Axes, shown: Map) -> None:
    options = {"cmap": shown.colour_map, "norm": shown.norm, "vmin": None, "vmax": None}
    drawn = panel(axes, shown.shown, shown.title, **options)
    # As high as the picture, whatever the frame's shape.
    drawing.colorbar(drawn, cax=axes.inset_axes((1.03, 0, 0.05, 1)), label=shown.label)


def _draw_lines(axes: Axes, shown: Map) -> None:
    """Lines of equal value, which are read without colour."""
    if min(shown.values.shape) < 2 or not np.isfinite(shown.values).any():
        return
    levels: NDArray[np.float64] = np.linspace(shown.low, shown.high, _LINES + 1)[1:-1]
    axes.contour(shown.shown, levels, colors="white", linewidths=0.5)
