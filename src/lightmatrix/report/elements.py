"""The elements of a section, such as galleries and tables; the templates lay out each kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias


@dataclass(frozen=True)
class Scale:
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
    scale: Scale | None = None


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side, as many as fit the screen."""

    images: tuple[Image, ...]
    size: Literal["medium", "wide"] = "medium"
    kind: ClassVar[str] = "gallery"


@dataclass(frozen=True)
class Pair:
    """A pattern, the photograph under it, and a few words."""

    number: int
    pattern: Image
    photograph: Image
    note: str


@dataclass(frozen=True)
class Strip:
    """Pairs of patterns and photographs in the order of the capture."""

    pairs: tuple[Pair, ...]
    kind: ClassVar[str] = "strip"


@dataclass(frozen=True)
class Table:
    """A table whose first column names the row."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Bars:
    """A chart of one bar per frame: heights as shares of the tallest, whose value is `most`."""

    title: str
    # The chart in words and numbers.
    description: str
    heights: tuple[float, ...]
    most: str
    # The frames of the first and last bar.
    first: int
    last: int
    kind: ClassVar[str] = "bars"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Points:
    """A bullet list of sentences."""

    items: tuple[str, ...]
    kind: ClassVar[str] = "points"


@dataclass(frozen=True)
class Columns:
    """Elements in two columns on wide screens, below each other on narrow ones."""

    left: tuple[Element, ...]
    right: tuple[Element, ...]
    kind: ClassVar[str] = "columns"


Element: TypeAlias = "Gallery | Strip | Table | Bars | Text | Points | Columns"


@dataclass(frozen=True)
class Section:
    """A part of the report: its anchor for links, heading, first paragraph and elements."""

    anchor: str
    title: str
    lead: str
    elements: tuple[Element, ...]
