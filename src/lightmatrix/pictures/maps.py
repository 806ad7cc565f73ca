"""Maps over the camera: one value per camera pixel, with its colours; images for display.

`lightmatrix show`, `lightmatrix info` and the report draw the same maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.images import DISPLAY_GAMMA
from lightmatrix.reprs import percent
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport

if TYPE_CHECKING:
    import matplotlib as mpl
    from matplotlib.colors import Colormap, Normalize
else:
    mpl = lazy_loader.load("matplotlib")

# Red, green and blue in [0, 1] that mark clipped pixels: a strong red, unlike any grey.
CLIPPED_COLOUR = (0.90, 0.10, 0.12)
# The grey of camera pixels without a value.
UNKNOWN = (0.7, 0.7, 0.7)


@dataclass(frozen=True, eq=False)
class Map:
    """One value for each camera pixel, and how to colour it."""

    title: str
    # The quantity and unit of the colour scale.
    label: str
    # (rows, cols); NaN where a pixel has no value.
    values: NDArray[np.floating]
    # The values at the ends of the colour scale.
    low: float
    high: float
    # Lightness must rise or fall along the whole colour map, so that it reads without colour.
    colours: str | Colormap = "viridis"
    # Whether colours follow the logarithm, which needs low > 0.
    logarithmic: bool = False

    @property
    def norm(self) -> Normalize:
        """The map from values to [0, 1]; values beyond the ends are clipped."""
        kind = mpl.colors.LogNorm if self.logarithmic else mpl.colors.Normalize
        return kind(self.low, self.high, clip=True)

    @property
    def colour_map(self) -> Colormap:
        """The colours, with grey for pixels without a value."""
        return mpl.colormaps.get_cmap(self.colours).with_extremes(bad=UNKNOWN)

    @property
    def shown(self) -> np.ma.MaskedArray[tuple[int, int], np.dtype[np.float64]]:
        """Values clipped to the scale, with missing ones masked."""
        return np.ma.masked_invalid(np.clip(self.values, self.low, self.high))

    def pixels(self) -> NDArray[np.uint8]:
        """The map as an image, (rows, cols, 3)."""
        return np.asarray(self.colour_map(self.norm(self.shown), bytes=True))[..., :3]


def display(image: NDArray[Any], white: float) -> NDArray[np.float64]:
    """A linear image for display: divided by `white`, clipped to [0, 1], gamma 2.2."""
    return np.clip(np.asarray(image, float) / max(white, 1e-12), 0, 1) ** (1 / DISPLAY_GAMMA)


def white_level(image: NDArray[Any]) -> float:
    """The light that a picture shows as white: that of all but the brightest 0.5 % of its pixels.

    Chosen by eye: highlights must not make everything else dark.
    """
    level = float(np.quantile(image, 0.995))
    return level if level > 0 else 1.0


def colour_bytes(colours: str | Colormap) -> NDArray[np.uint8]:
    """The colours of a scale as (256, 3) bytes. A map with fewer would show bands."""
    return np.asarray(mpl.colormaps.get_cmap(colours)(np.linspace(0, 1, 256), bytes=True))[:, :3]


def white_to_red() -> Colormap:
    """The colours of shares of clipped samples."""
    ends = [(1.0, 1.0, 1.0), CLIPPED_COLOUR]
    return mpl.colors.LinearSegmentedColormap.from_list("clipped", ends)


def light_map(light: NDArray[np.floating], title: str) -> Map:
    """A row or column of T as an image, whose light fades over four decades around its peak."""
    peak = max(float(light.max()), 1e-12)
    label = "camera full scale per projector pixel"
    return Map(title, label, light, peak / 1e4, peak, "inferno", logarithmic=True)


def clipping_map(transport: LightTransport) -> Map:
    """Share of each camera pixel's samples that clipped, in per cent, in the worst channel."""
    shares = 100 * _diagnostic(transport, "clipped_share")
    title = f"Clipped samples: {np.mean(shares):.1f} %"
    label = "clipped share of a camera pixel's samples, %"
    return Map(title, label, shares, 0, 100, white_to_red())


def gap_map(transport: LightTransport) -> Map:
    """Relative duality gap of each row, the largest of a pixel's channels."""
    gaps = _diagnostic(transport, "gap")
    known = gaps[np.isfinite(gaps)]
    if not known.size:
        raise InputError("no row has a duality gap", hint="estimate with the solver active-set")
    title = f"Duality gap: median {percent(np.median(known))}, largest {percent(known.max())}"
    label = "relative duality gap; dark: converged"
    # Gaps below the usual tolerance look alike: bright pixels are rows that did not converge.
    return Map(title, label, gaps, 1e-3, 1, logarithmic=True)


def footprint_map(transport: LightTransport) -> Map:
    """Size of each camera pixel's footprint in projector pixels."""
    sizes = _diagnostic(transport, "footprint")
    known = sizes[np.isfinite(sizes)]
    middle, high = np.quantile(known, (0.5, 0.99)).tolist() if known.size else (0.0, 1.0)
    title = f"Footprint size: median {middle:.2g} projector pixels"
    return Map(title, "projector pixels", sizes, 0, max(high, 1.0))


def estimated_error_map(transport: LightTransport) -> Map:
    """The estimated relative error of each camera pixel's rows."""
    errors = _diagnostic(transport, "estimated_error")
    return _of_errors("Estimated error per camera pixel", "estimated ", errors)


def changes_map(transport: LightTransport) -> Map:
    """The photograph with which each camera pixel changed last; grey for those that did not."""
    since, unknown = (_diagnostic(transport, name) for name in ("since", "unknown"))
    shares = [percent(float(np.mean(each > 0))) for each in (since, unknown)]
    title = f"Changed: {shares[0]}; not known yet: {shares[1]}"
    values = np.where(since > 0, since, np.nan)
    return Map(title, "number of the photograph", values, 1, max(2.0, since.max()))


def error_map(values: NDArray[np.floating]) -> Map:
    """Relative error of each camera pixel against the truth, (rows, cols); NaN where T is dark."""
    return _of_errors("Error against the truth", "", values.astype(float))


def _of_errors(title: str, kind: str, errors: NDArray[np.float64]) -> Map:
    known = errors[np.isfinite(errors)]
    middle = 100 * float(np.median(known)) if known.size else np.nan
    label = f"{kind}relative error of a camera pixel's row"
    title += f": median {middle:.2g} %"
    # The scale ends at 100 %, the error of T = 0, and begins at 0.1 %, which noise hides.
    return Map(title, label, errors, 1e-3, 1.0, "magma", logarithmic=True)


def correspondence_maps(matches: Correspondence) -> tuple[Map, Map, Map]:
    """Row and column of the projector that each camera pixel sees most, and the confidence."""
    row, col = np.moveaxis(matches.place.astype(np.float64), -1, 0)
    confidence = np.where(matches.valid, matches.confidence.astype(np.float64), np.nan)
    middle = 100 * float(np.median(confidence[matches.valid])) if matches.valid.any() else 0.0
    label = "share of the light from 5 x 5 projector pixels"
    return (
        Map("Projector row", "projector row", row, *_ends(row)),
        Map("Projector column", "projector column", col, *_ends(col)),
        Map(f"Confidence: median {middle:.0f} %", label, confidence, 0, 1, "gray"),
    )


def _ends(places: NDArray[np.float64]) -> tuple[float, float]:
    """The range of projector rows or columns that holds nearly all places."""
    known = places[np.isfinite(places)]
    if not known.size:
        return 0, 1
    # Wrong matches may lie anywhere, so the scale leaves out 0.5 % at either end.
    low, high = np.quantile(known, (0.005, 0.995))
    return float(np.floor(low)), float(max(np.ceil(high), np.floor(low) + 1))


def has_diagnostic(transport: LightTransport, name: str) -> bool:
    """Whether any row has a value of this diagnostic."""
    values = transport.diagnostics.get(name)
    return values is not None and bool(np.isfinite(np.asarray(values, float)).any())


def _diagnostic(transport: LightTransport, name: str) -> NDArray[np.float64]:
    """A diagnostic of each camera pixel, (rows, cols), the largest of its channels."""
    if name not in transport.diagnostics:
        kinds = dict.fromkeys(("footprint", "estimated_error"), "a coherent estimate")
        kinds["since"] = "a `Tracker` (of `lightmatrix track`)"
        hint = f"give that of {kinds.get(name, 'an estimate')}, or a store (.zarr) of one"
        what = "record of changes" if name == "since" else name.replace("_", " ")
        raise InputError(f"this matrix has no {what} of its rows", hint=hint)
    image = np.asarray(transport.diagnostics[name], float).reshape(transport.camera_shape)
    if image.ndim == 2:
        return image
    # A pixel is NaN only if all its channels are.
    known = np.where(np.isfinite(image), image, -np.inf).max(axis=2)
    return np.where(np.isfinite(known), known, np.nan)
