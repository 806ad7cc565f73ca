"""The elements of a section, such as galleries and tables; the templates lay out each kind."""

import base64
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.images import encode_image, read_image
from lightmatrix.patterns.pattern_set import block_mean
from lightmatrix.pictures.maps import Map, display, light_map, white_level


@dataclass(frozen=True)
class ColourScale:
    """A colour scale: its colours as an image address, the values at its ends, and its label."""

    bar: str
    low: str
    high: str
    label: str


@dataclass(frozen=True)
class Image:
    """A picture (a data: address, its size in pixels), its description for blind readers, words."""

    source: str
    width: int
    height: int
    alternative: str
    title: str = ""
    caption: str = ""
    scale: ColourScale | None = None


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side, as many as fit the screen."""

    images: tuple[Image, ...]
    size: Literal["medium", "wide"] = "medium"
    kind: ClassVar[str] = "gallery"


@dataclass(frozen=True)
class Table:
    """A table whose first column names the row."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    # Whether only the title is seen until a reader opens it.
    folded: bool = False
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Bars:
    """A chart of one bar per frame: heights as shares of the tallest, whose value is `most`."""

    title: str
    # The chart in words and numbers.
    description: str
    heights: tuple[float, ...]
    most: str
    # The frame of the last bar; the first one is 0.
    last: int
    kind: ClassVar[str] = "bars"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Columns:
    """Elements in two columns on wide screens, below each other on narrow ones."""

    left: "tuple[Element, ...]"
    right: "tuple[Element, ...]"
    kind: ClassVar[str] = "columns"


Element: TypeAlias = "Gallery | Table | Bars | Text | Columns"


@dataclass(frozen=True)
class Section:
    """A part of the report: its anchor for links, heading, first paragraph and elements."""

    anchor: str
    title: str
    lead: str
    elements: tuple[Element, ...]


# Arrays as images of the report: small enough for one page, with alternative texts and scales.

# The longer side of a picture has at most this many pixels, which fills a column of the page.
MOST_PIXELS = 320
# Photographs of up to this many pixels a side are stored without loss: single pixels are visible on
# the page, and noise does not make the file large.
MOST_LOSSLESS = 128
_BAR_PIXELS = 64

Shrinking = Literal["mean", "largest", "sampled"]


def image_of_map(shown: Map, caption: str = "") -> Image:
    """A map over the camera, with the scale of its colours."""
    pixels = _shrink(shown.pixels(), MOST_PIXELS, "sampled")
    steps = np.linspace(0, 1, _BAR_PIXELS)
    bar = np.asarray(shown.colour_map(steps, bytes=True))[None, :, :3]
    scale = ColourScale(_address(bar), _number(shown.low), _number(shown.high), shown.label)
    logarithmic = ", on a logarithmic scale" if shown.logarithmic else ""
    known = shown.values[np.isfinite(shown.values)]
    range_ = "no pixel has a value"
    if known.size:
        low, middle, high = np.quantile(known, (0.05, 0.5, 0.95))
        range_ = (
            f"90 % of the pixels lie between {low:.3g} and {high:.3g}, the median is {middle:.3g}"
        )
    alternative = f"Map over the camera of the {shown.label}{logarithmic}: {range_}."
    return _image(pixels, alternative, shown.title, caption, scale)


def photograph(
    light: NDArray[Any], alternative: str, title: str = "", caption: str = "",
    *, white: float | None = None,
) -> Image:  # fmt: skip
    """A linear image (rows, cols[, 3]) with gamma 2.2."""
    level = white_level(light) if white is None else white
    shown = display(_shrink(np.asarray(light, float), MOST_PIXELS, "mean"), level)
    small = max(shown.shape[:2]) <= MOST_LOSSLESS
    return _image(_bytes(shown), alternative, title, caption, exact=small)


def pattern_image(pattern: NDArray[Any], alternative: str, title: str) -> Image:
    """A pattern with its values in [0, 1] as grey levels."""
    shown = np.clip(_shrink(np.asarray(pattern, float), MOST_PIXELS, "mean"), 0, 1)
    return _image(_bytes(shown), alternative, title, "")


def colour_image(
    colours: NDArray[np.floating], alternative: str, title: str = "", caption: str = ""
) -> Image:
    """An image (rows, cols, 3) of colours in [0, 1], as they are."""
    return _image(_bytes(_shrink(colours, MOST_PIXELS, "sampled")), alternative, title, caption)


def faint_image(light: NDArray[Any], title: str, caption: str = "") -> Image:
    """A row or column of T, with the faint light around its bright spot made visible."""
    small = _shrink(np.asarray(light, float), MOST_PIXELS, "largest")
    return image_of_map(light_map(small, title), caption)


def difference_image(
    difference: NDArray[Any], least: float, alternative: str, title: str, caption: str = ""
) -> Image:
    """A difference: grey where it is 0, darker below, brighter above.

    The scale holds all but the largest differences, and ends at `least` or above.
    """
    grey = np.asarray(difference, float)
    grey = grey if grey.ndim == 2 else grey.mean(axis=2)
    most = max(least, float(np.quantile(abs(grey), 0.99)))
    shown = np.clip(0.5 + 0.5 * _shrink(grey, MOST_PIXELS, "mean") / max(most, 1e-12), 0, 1)
    bar = _bytes(np.linspace(0, 1, _BAR_PIXELS)[None])
    scale = ColourScale(
        _address(bar), _number(-most), f"+{_number(most)}", "relative to the clip level"
    )
    return _image(_bytes(shown), alternative, title, caption, scale)


def image_of_file(file: Path, alternative: str, title: str = "", caption: str = "") -> Image:
    """A picture from a file, such as a figure."""
    return _image(read_image(file), alternative, title, caption)


def _image(
    pixels: NDArray[np.uint8], alternative: str, title: str, caption: str,
    scale: ColourScale | None = None, *, exact: bool = True,
) -> Image:  # fmt: skip
    rows, cols = pixels.shape[:2]
    return Image(_address(pixels, exact), cols, rows, alternative, title, caption, scale)


def _address(pixels: NDArray[np.uint8], exact: bool = True) -> str:
    """An image as a data: address, lossless if `exact`."""
    # The qualities of WebP were chosen by eye and by file size.
    options: dict[str, Any] = {"lossless": True, "quality": 60} if exact else {"quality": 88}
    coloured = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
    encoded = encode_image(coloured, "webp", **options)
    return "data:image/webp;base64," + base64.b64encode(encoded).decode("ascii")


def _shrink(image: NDArray[Any], most: int, how: Shrinking) -> NDArray[Any]:
    """An image of at most `most` pixels a side, shrunk by a whole number of pixels."""
    block = -(-max(image.shape[:2]) // most)
    if block == 1:
        return image
    if how == "sampled":
        first = [min(block // 2, size - 1) for size in image.shape[:2]]
        return image[first[0] :: block, first[1] :: block]
    if how == "largest":
        for axis in (0, 1):
            starts = np.arange(0, image.shape[axis], block)
            image = np.maximum.reduceat(image, starts, axis=axis)
        return image
    if image.ndim == 2:
        return block_mean(image[None], (block, block))[0]
    return np.moveaxis(block_mean(np.moveaxis(image, 2, 0), (block, block)), 0, 2)


def _bytes(shown: NDArray[Any]) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)


def _number(value: float) -> str:
    return f"{Decimal(f'{value:.2g}'):f}" if abs(value) < 100 else f"{value:.0f}"
