"""Pictures of a light transport matrix: rows, columns, relit and dual images."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lightmatrix.files.kinds import PICTURE
from lightmatrix.files.writing import atomic_file
from lightmatrix.patterns.pattern_set import to_grey
from lightmatrix.pictures.style import CLIPPED_COLOUR, COLOURS, STYLE, display, mark_clipped, panel
from lightmatrix.ranges import check_number
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import singular_values

_UNIT = "camera full scale per projector pixel"
# The colours of a row or column follow this power of the values, which makes faint light beside a
# bright spot visible. Chosen by eye.
FAINT = 0.35
# This share of a picture's pixels, the brightest, is shown as white. Chosen by eye: highlights must
# not make everything else dark.
_GLINTS = 0.005
# Picture files have this many dots per inch.
DPI = 150


class Picture(Figure):
    """A Matplotlib figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", facecolor="white", dpi=self.dpi)
        return stream.getvalue()

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the figure as a .png file."""
        with atomic_file(path, PICTURE, overwrite=overwrite) as part:
            self.savefig(part, facecolor="white", dpi=DPI)


def show_row(transport: LightTransport, *camera_index: int) -> Picture:
    """Picture of a row of T: how much light each projector pixel sends to one camera sample.

    Parameters
    ----------
    transport : LightTransport
        T.
    camera_index : int
        Row, column and, for a colour camera, channel.

    Returns
    -------
    Picture
        A Matplotlib figure; ``savefig`` writes it.

    Raises
    ------
    InputError
        If there is no such camera sample.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_row(lm.truth("metal").transport(), 20, 30).savefig("row.png")
    """
    transport.row_number(camera_index)  # Refuses a pixel that the camera does not have.
    place = ", ".join(map(str, camera_index)) + _photograph_pixel(transport, camera_index)
    return _faint(transport.row(*camera_index), f"Row of T: the light of camera pixel {place}")


def show_column(transport: LightTransport, row: int, col: int) -> Picture:
    """Picture of a column of T: what the camera sees when one projector pixel is lit.

    Parameters
    ----------
    transport : LightTransport
        T.
    row, col : int
        The projector pixel.

    Returns
    -------
    Picture
        A Matplotlib figure. A colour camera shows the mean of its channels.

    Raises
    ------
    InputError
        If there is no such projector pixel.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_column(lm.truth("metal").transport(), 20, 30).savefig("column.png")
    """
    image = _grey(transport.column(row, col))
    return _faint(image, f"Column of T: projector pixel {row}, {col} alone")


def show_relit(
    transport: LightTransport, pattern: NDArray[Any], *, exposure: float | None = None
) -> Picture:
    """Picture of the scene under a pattern, beside the pattern.

    Parameters
    ----------
    transport : LightTransport
        T.
    pattern : (rows, cols) array
        Pattern of the projector's shape, in [0, 1].
    exposure : float, optional
        Exposure of the image; clipped pixels are red. None: one at which hardly any pixel clips.

    Returns
    -------
    Picture
        A Matplotlib figure; the image has a display gamma of 2.2.

    Raises
    ------
    InputError
        On a pattern of another shape, or an exposure that is not above 0.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> stripes = np.zeros((64, 64))
    >>> stripes[:, ::8] = 1
    >>> lm.show_relit(lm.truth("metal").transport(), stripes).savefig("relit.png")
    """
    image = transport.relight(pattern)
    title = "The scene under this pattern"
    if exposure is None:
        shown = display(image, _white(image))
    else:
        hint = "use a number above 0, such as 1"
        check_number("an exposure", exposure, most=1e9, above=True, hint=hint)
        light = exposure * image
        clipped = light >= 1
        shown = display(light, 1.0)
        if clipped.any():
            shown = _marked(shown, clipped)
            title += f": {100 * clipped.mean():.1f} % clip (red)"
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(6.4, 3.4), layout="constrained")
        axes = drawing.subplots(1, 2)
        panel(axes[0], to_grey(np.asarray(pattern)) / 255, "Pattern")
        panel(axes[1], shown, title)
    return drawing


def show_dual(transport: LightTransport, lights: NDArray[Any] | None = None) -> Picture:
    """Picture of the scene as the projector would photograph it, lit from the camera.

    Parameters
    ----------
    transport : LightTransport
        T.
    lights : camera_shape array, optional
        Strength of each camera sample as a light. None: all equal, with a colour image from a
        colour camera.

    Returns
    -------
    Picture
        A Matplotlib figure; the image has a display gamma of 2.2.

    Raises
    ------
    InputError
        If the lights do not have the camera's shape.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_dual(lm.truth("metal").transport()).savefig("dual.png")
    """
    image = transport.dual_image() if lights is None else transport.dual(lights)
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(3.6, 3.6), layout="constrained")
        title = "Dual image: seen from the projector"
        panel(drawing.subplots(), display(image, _white(image)), title)
    return drawing


def _photograph_pixel(transport: LightTransport, camera_index: tuple[int, ...]) -> str:
    """The pixel of the whole photographs, in words, if the estimate is from cropped ones."""
    region = transport.region
    if region is None:
        return ""
    down, right = transport.provenance["capture_description"].get("bin_camera", (1, 1))
    row, col = region.corner[0] + camera_index[0] * down, region.corner[1] + camera_index[1] * right
    return f"\n(pixel {row}, {col} of the photographs)"


def _faint(image: NDArray[Any], title: str) -> Picture:
    """Draw one bright spot and the faint light around it, with a colour scale."""
    # Negative light, which some estimates allow, is drawn black.
    brightest = max(float(image.max()), 1e-12)
    norm = PowerNorm(FAINT, 0, brightest, clip=True)
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(4.6, 3.6), layout="constrained")
        axes = drawing.subplots()
        drawn = panel(axes, image, title, cmap="inferno", norm=norm, vmin=None, vmax=None)
        ticks = [share * brightest for share in (0, 0.01, 0.05, 0.2, 0.5, 1)]
        drawing.colorbar(drawn, ax=axes, label=_UNIT, ticks=ticks, format="%.2g")
    return drawing


def _white(image: NDArray[Any]) -> float:
    return float(np.quantile(image, 1 - _GLINTS))


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    return image if image.ndim == 2 else image.mean(axis=2)


def _marked(shown: NDArray[np.float64], clipped: NDArray[np.bool_]) -> NDArray[np.float64]:
    if shown.ndim == 2:
        return mark_clipped(shown, clipped)
    marked = shown.copy()
    marked[clipped.any(axis=2)] = CLIPPED_COLOUR
    return marked


# Picture of the singular values of T: how low the rank of the light is.


# Singular values that are drawn, if T has so many.
_VALUES = 50


def spectrum(transport: LightTransport) -> Mapping[str, NDArray[Any]]:
    """The largest singular values of T, ``values``."""
    return {"values": singular_values(transport, min(_VALUES, *transport.shape))}


def show_spectrum(transport: LightTransport) -> Picture:
    """Picture of the largest singular values of T, as shares of the largest."""
    values = spectrum(transport)["values"]
    shares = values / max(float(values[0]), np.finfo(float).tiny)
    with mpl.rc_context(STYLE):
        drawing = Picture(figsize=(4.2, 2.8), layout="constrained")
        axes = drawing.subplots()
        axes.plot(np.arange(1, len(shares) + 1), shares, "o-", color=COLOURS[0], markersize=3)
        axes.set_ylim(0, 1.05)
        axes.set_title(f"Singular values of T: the {len(shares)} largest")
        axes.set_xlabel("number")
        axes.set_ylabel("share of the largest")
        axes.grid(axis="y", color="0.92", linewidth=0.6)
    return drawing
