"""Pictures of the diagnostics of an estimate, as maps over the camera."""

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
    estimated_error_map,
    footprint_map,
    gap_map,
)
from lightmatrix.pictures.style import STYLE, panel
from lightmatrix.pictures.transport import Picture
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import LightTransport

# Lines of equal value divide a map of projector rows or columns into this many bands.
_BANDS = 8


def show_clipping(transport: LightTransport) -> Picture:
    """Picture of the share of each camera pixel's samples that clipped.

    Parameters
    ----------
    transport : LightTransport
        An estimate.

    Returns
    -------
    Picture
        A Matplotlib figure. For a colour camera it shows the channel that clipped most.

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
    """Picture of the relative duality gap of each row, the most that it can miss its optimum by.

    Parameters
    ----------
    transport : LightTransport
        An estimate of a solver that computes gaps, such as active-set.

    Returns
    -------
    Picture
        A Matplotlib figure. Rows without a gap are grey; a colour camera shows its largest gap.

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
    """Picture of the size of each camera pixel's footprint, which is large where out of focus.

    Parameters
    ----------
    transport : LightTransport
        An estimate that measured footprints, as the coherent one does.

    Returns
    -------
    Picture
        A Matplotlib figure, in projector pixels. A colour camera shows its largest channel.

    Raises
    ------
    InputError
        If the estimate did not measure footprints.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_footprints(lm.open("scene.zarr")).savefig("footprints.png")  # doctest: +SKIP
    """
    return draw(footprint_map(transport))


def show_estimated_errors(transport: LightTransport) -> Picture:
    """Picture of the estimated relative error of each row.

    Parameters
    ----------
    transport : LightTransport
        An estimate that estimates its errors, as the coherent one does.

    Returns
    -------
    Picture
        A Matplotlib figure. A colour camera shows its largest error.

    Raises
    ------
    InputError
        If the estimate has no estimated errors.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_estimated_errors(lm.open("scene.zarr")).savefig("errors.png")  # doctest: +SKIP
    """
    return draw(estimated_error_map(transport))


def show_correspondence(transport: LightTransport) -> Picture:
    """Picture of the projector pixel that each camera pixel sees most, and of the confidence.

    Parameters
    ----------
    transport : LightTransport
        T.

    Returns
    -------
    Picture
        A Matplotlib figure of three maps: projector row, projector column, and the share of the
        light that comes from there. `correspondence` returns the numbers.

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
    # The colour bar is as high as the map, whatever the frame's shape.
    drawing.colorbar(drawn, cax=axes.inset_axes((1.03, 0, 0.05, 1)), label=shown.label)


def _draw_lines(axes: Axes, shown: Map) -> None:
    """Draw lines of equal value, which can be read without colour."""
    if min(shown.values.shape) < 2 or not np.isfinite(shown.values).any():
        return
    levels: NDArray[np.float64] = np.linspace(shown.low, shown.high, _BANDS + 1)[1:-1]
    axes.contour(shown.shown, levels, colors="white", linewidths=0.5)
