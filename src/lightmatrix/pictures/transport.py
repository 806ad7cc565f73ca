"""Pictures of a light transport matrix: rows, columns, images under light."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.outputs.kinds import PICTURE
from lightmatrix.outputs.writing import atomic_file
from lightmatrix.patterns.pattern_set import to_grey
from lightmatrix.pictures.style import CLIPPED_COLOUR, STYLE, display, mark_clipped, panel
from lightmatrix.ranges import check_number
from lightmatrix.transport.matrix import LightTransport

_UNIT = "camera full scale per projector pixel"
# Faint light beside a bright spot: the colours follow this power of the values.
FAINT = 0.35
# Of the brightest pixels of a picture, the share that is shown as white whatever it is.
_GLINTS = 0.005
# Of pictures in files.
DPI = 150


class Picture(Figure):
    """A Matplotlib figure that a notebook shows as it is, without pyplot."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", facecolor="white", dpi=self.dpi)
        return stream.getvalue()

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write it as a .png file, whole or not at all.

        Raises
        ------
        OutputError
            If there is a file that is no picture or must not be replaced, or the disk fails.
        """
        with atomic_file(path, PICTURE, overwrite=overwrite) as part:
            self.savefig(part, facecolor="white", dpi=DPI)


def show_row(transport: LightTransport, *camera_index: int) -> Picture:
    """Picture of a row of T: how each projector pixel reaches one camera sample.

    Parameters
    ----------
    transport : LightTransport
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
    _check_index(camera_index, transport.camera_shape, "camera sample")
    place = ", ".join(map(str, camera_index)) + _of_photograph(transport, camera_index)
    return _faint(transport.row(*camera_index), f"Row of T: the light of camera pixel {place}")


def show_column(transport: LightTransport, row: int, col: int) -> Picture:
    """Picture of a column of T: what the camera sees when one projector pixel is lit.

    Parameters
    ----------
    transport : LightTransport
    row, col : int
        The projector pixel.

    Returns
    -------
    Picture
        A Matplotlib figure; of a colour camera, the mean of its channels.

    Raises
    ------
    InputError
        If there is no such projector pixel.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.show_column(lm.truth("metal").transport(), 20, 30).savefig("column.png")
    """
    _check_index((row, col), transport.projector_shape, "projector pixel")
    image = _grey(transport.column(row, col))
    return _faint(image, f"Column of T: projector pixel {row}, {col} alone")


def show_relit(
    transport: LightTransport, pattern: NDArray[Any], *, exposure: float | None = None
) -> Picture:
    """Picture of the scene under a pattern, beside the pattern.

    Parameters
    ----------
    transport : LightTransport
    pattern : (rows, cols) array
        Of the projector's shape, in [0, 1].
    exposure : float, optional
        Exposure of the image; what clips is shown in red. None: one at which hardly anything does.

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
    title = "The scene under it"
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
    lights : camera_shape array, optional
        How strongly each camera sample acts as a light. None: all alike, and a colour camera in
        its colours.

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
        panel(drawing.subplots(), display(image, _white(image)), "Dual image: seen from projector")
    return drawing


def _of_photograph(transport: LightTransport, camera_index: tuple[int, ...]) -> str:
    """Where a camera pixel of an estimate from cropped photographs lies in these, in words."""
    region = transport.region
    if region is None:
        return ""
    down, right = transport.provenance["capture_description"].get("bin_camera", (1, 1))
    row, col = region.corner[0] + camera_index[0] * down, region.corner[1] + camera_index[1] * right
    return f"\n(pixel {row}, {col} of the photographs)"


def _faint(image: NDArray[Any], title: str) -> Picture:
    """An image of one bright spot and faint light, with the scale of its colours."""
    # Negative light, which some estimates allow, is as dark as none.
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


def _check_index(index: tuple[int, ...], shape: tuple[int, ...], what: str) -> None:
    fits = len(index) == len(shape)
    if not fits or not all(0 <= i < n for i, n in zip(index, shape, strict=True)):
        raise InputError(
            f"there is no {what} {index}",
            hint=f"the shape is {' x '.join(map(str, shape))}, counted from 0",
        )
