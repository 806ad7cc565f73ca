"""Maps over the camera: one value a camera pixel, and the colours that show it.

The pictures of `lightmatrix show` and `lightmatrix info`, and the report, draw the same maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.pictures.style import CLIPPED_COLOUR
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport

WHITE_TO_RED = LinearSegmentedColormap.from_list("clipped", [(1.0, 1.0, 1.0), CLIPPED_COLOUR])
# Where a camera pixel has no value.
UNKNOWN = (0.7, 0.7, 0.7)
# Gaps far below any tolerance, and those of dark rows (0), look alike.
_SMALLEST_GAP = 1e-7
# Errors above are no estimate at all; below, noise.
_ERRORS = (1e-3, 1.0)
# Facts that only some estimates state.
_COHERENT = ": the coherent estimate measures it"
_KNOWN_BY = {"footprint": _COHERENT, "estimated_error": _COHERENT}
# Of the places at either end, so many may lie beyond the colours: wrong ones lie anywhere.
_STRAYS = 0.005


@dataclass(frozen=True, eq=False)
class Map:
    """One value for each camera pixel, and how it is coloured.

    Parameters
    ----------
    name : str
        In one word, such as the name of a file.
    title : str
        What it shows, with its most telling numbers.
    label : str
        What the colours mean, with the unit.
    values : (rows, cols) float64
        NaN where there is none.
    low, high : float
        What the ends of the colours stand for.
    colours : str or Colormap
        A colour map whose lightness grows or falls all the way, so that it is read without colour.
    logarithmic : bool
        Whether colours follow the logarithm; `low` is then above 0.
    """

    name: str
    title: str
    label: str
    values: NDArray[np.float64]
    low: float
    high: float
    colours: str | Colormap = "viridis"
    logarithmic: bool = False

    @property
    def norm(self) -> Normalize:
        """From values to [0, 1]; what lies beyond the ends is shown like them."""
        return (LogNorm if self.logarithmic else Normalize)(self.low, self.high, clip=True)

    @property
    def colour_map(self) -> Colormap:
        """The colours, with grey for what is not known."""
        return mpl.colormaps.get_cmap(self.colours).with_extremes(bad=UNKNOWN)

    @property
    def shown(self) -> np.ma.MaskedArray[tuple[int, int], np.dtype[np.float64]]:
        """Values as they are drawn: within the ends, those that are not known masked."""
        return np.ma.masked_invalid(np.clip(self.values, self.low, self.high))

    def pixels(self) -> NDArray[np.uint8]:
        """The map as a picture, (rows, cols, 3) uint8, a camera pixel a pixel."""
        return np.asarray(self.colour_map(self.norm(self.shown), bytes=True))[..., :3]


def clipping_map(transport: LightTransport) -> Map:
    """How many of each camera pixel's samples clipped, in per cent.

    Of a colour camera, the channel that clipped most.

    Raises
    ------
    InputError
        If the matrix does not come from a capture.
    """
    shares = 100 * _diagnostic(transport, "clipped_share")
    title = f"Samples that clipped: {np.mean(shares):.1f} %"
    label = "of a camera pixel's samples, %"
    return Map("clipping", title, label, shares, 0, 100, WHITE_TO_RED)


def gap_map(transport: LightTransport) -> Map:
    """Relative duality gap of each row: how far from its optimum it can be.

    Of a colour camera, the largest gap.

    Raises
    ------
    InputError
        If no row has a gap.
    """
    gaps = _diagnostic(transport, "gap")
    known = gaps[np.isfinite(gaps)]
    if not known.size:
        raise InputError("no row has a duality gap", hint="estimate with the solver active-set")
    # No line is to end within 7e-06.
    middle, largest = (
        f"{gap:.1g}".replace("-", "\u2011") for gap in (np.median(known), known.max())
    )
    title = f"Relative duality gap: median {middle}, largest {largest}"
    label = "(P - D) / P of a camera pixel's row"
    high = max(1e-3, float(known.max()))
    return Map("gap", title, label, gaps, _SMALLEST_GAP, high, logarithmic=True)


def footprint_map(transport: LightTransport) -> Map:
    """Size of each camera pixel's footprint on the projector: what is out of focus.

    Raises
    ------
    InputError
        If the estimate did not measure it.
    """
    sizes = _diagnostic(transport, "footprint")
    known = sizes[np.isfinite(sizes)]
    middle = float(np.median(known)) if known.size else 0.0
    high = max(float(np.quantile(known, 0.99)) if known.size else 0.0, 1.0)
    title = f"Size of footprints: median {middle:.2g} projector pixels"
    return Map("footprint", title, "projector pixels", sizes, 0, high)


def stated_error_map(transport: LightTransport) -> Map:
    """The relative error that the estimate states of each row.

    Raises
    ------
    InputError
        If the estimate states none.
    """
    errors = _diagnostic(transport, "estimated_error")
    known = errors[np.isfinite(errors)]
    middle = 100 * float(np.median(known)) if known.size else np.nan
    title = f"Error that the estimate states: median {middle:.2g} %"
    label = "relative error of a camera pixel's row, stated"
    return Map("stated-error", title, label, errors, *_ERRORS, "magma", logarithmic=True)


def error_map(values: NDArray[np.floating]) -> Map:
    """Relative error of each row against the truth, (rows, cols); NaN where T is dark."""
    known = values[np.isfinite(values)]
    middle = 100 * float(np.median(known)) if known.size else np.nan
    title = f"Error against the truth: median {middle:.2g} %"
    label = "relative error of a camera pixel's row"
    return Map("error", title, label, values.astype(float), *_ERRORS, "magma", logarithmic=True)


def correspondence_maps(found: Correspondence) -> tuple[Map, Map, Map]:
    """Row and column of the projector that each camera pixel sees most, and how sure that is."""
    row, col = np.moveaxis(found.place.astype(np.float64), -1, 0)
    confidence = np.where(found.valid, found.confidence.astype(np.float64), np.nan)
    middle = 100 * float(np.median(confidence[found.valid])) if found.valid.any() else 0.0
    of_window = "share of the light from 5 x 5 projector pixels"
    return (
        Map("row", "Projector row", "projector row", row, *_ends(row)),
        Map("column", "Projector column", "projector column", col, *_ends(col)),
        Map(
            "confidence", f"Confidence: median {middle:.0f} %", of_window, confidence, 0, 1, "gray"
        ),
    )


def _ends(places: NDArray[np.float64]) -> tuple[float, float]:
    """Between which rows or columns of the projector nearly all places lie."""
    known = places[np.isfinite(places)]
    if not known.size:
        return 0, 1
    low, high = np.quantile(known, (_STRAYS, 1 - _STRAYS))
    return float(np.floor(low)), float(max(np.ceil(high), np.floor(low) + 1))


def has_diagnostic(transport: LightTransport, name: str) -> bool:
    """Whether any row knows this fact of itself."""
    values = transport.diagnostics.get(name)
    return values is not None and bool(np.isfinite(np.asarray(values, float)).any())


def _diagnostic(transport: LightTransport, name: str) -> NDArray[np.float64]:
    """A fact of each camera pixel, (rows, cols): the largest of its channels."""
    if name not in transport.diagnostics:
        raise InputError(
            f"this matrix does not know the {name.replace('_', ' ')} of its rows",
            hint="give an estimate, or a store (.zarr) of one, "
            f"that knows it{_KNOWN_BY.get(name, '')}",
        )
    image = np.asarray(transport.diagnostics[name], float).reshape(transport.camera_shape)
    if image.ndim == 2:
        return image
    # NaN only where no channel knows.
    known = np.where(np.isfinite(image), image, -np.inf).max(axis=2)
    return np.where(np.isfinite(known), known, np.nan)
