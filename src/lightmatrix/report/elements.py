"""What a section of the report is made of. The templates lay out each kind of block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias


@dataclass(frozen=True)
class Scale:
    """What the colours of an image mean.

    Parameters
    ----------
    bar : str
        The colours from the lowest to the highest value, as an address of image data.
    low, high : str
        What the ends stand for.
    label : str
        Of what, with the unit.
    """

    bar: str
    low: str
    high: str
    label: str


@dataclass(frozen=True)
class Image:
    """A picture with its words.

    Parameters
    ----------
    source : str
        Address of image data (data:...).
    width, height : int
        In its own pixels.
    alternative : str
        What is to be seen, for who does not see it.
    title, caption : str
        Above and below it; empty for none.
    scale : Scale, optional
        Where colours stand for numbers.
    """

    source: str
    width: int
    height: int
    alternative: str
    title: str = ""
    caption: str = ""
    scale: Scale | None = None


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side, as many as the screen is wide."""

    images: tuple[Image, ...]
    size: Literal["small", "medium", "wide"] = "medium"
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
    """Patterns and photographs in the order in which they were taken."""

    pairs: tuple[Pair, ...]
    kind: ClassVar[str] = "strip"


@dataclass(frozen=True)
class Table:
    """Numbers or names under heads; the first column names the line."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Bars:
    """One bar a frame.

    Parameters
    ----------
    title : str
        What the bars show.
    description : str
        The same in words with numbers.
    unit : str
        Of the values, such as " %".
    heights : tuple of float
        Of the bars, as shares of the largest.
    most : str
        What the tallest bar stands for.
    first, last : int
        The frames of the first and last bar.
    """

    title: str
    description: str
    unit: str
    heights: tuple[float, ...]
    most: str
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
    """A list of sentences."""

    items: tuple[str, ...]
    kind: ClassVar[str] = "points"


@dataclass(frozen=True)
class Columns:
    """Blocks side by side where the screen is wide enough, below each other elsewhere."""

    left: tuple[Block, ...]
    right: tuple[Block, ...]
    kind: ClassVar[str] = "columns"


Block: TypeAlias = "Gallery | Strip | Table | Bars | Text | Points | Columns"


@dataclass(frozen=True)
class Section:
    """A part of the report under a heading.

    Parameters
    ----------
    anchor : str
        Its name in links.
    title : str
        The heading.
    lead : str
        What it tells, in a sentence or two.
    blocks : tuple of Block
    """

    anchor: str
    title: str
    lead: str
    blocks: tuple[Block, ...]
