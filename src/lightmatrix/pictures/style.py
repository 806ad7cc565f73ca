"""The style of all figures, and the panels that several of them share."""

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from lightmatrix.files.kinds import PICTURE
from lightmatrix.files.writing import atomic_file
from lightmatrix.pictures.maps import CLIPPED_COLOUR

# Colour-blind readers can tell the colours of this palette apart (Okabe and Ito).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.6,
    "savefig.dpi": 200,
    "figure.dpi": 100,
    "svg.hashsalt": "lightmatrix",
}


class Picture(Figure):
    """A Matplotlib figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", facecolor="white", dpi=self.dpi)
        return stream.getvalue()

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the figure as a .png file."""
        with atomic_file(path, PICTURE, overwrite=overwrite) as part:
            self.draw_file(part)

    def draw_file(self, file: Path) -> None:
        """Write the figure to a new file, 150 dots an inch."""
        self.savefig(file, facecolor="white", dpi=150)


@contextmanager
def figure(width: float, height: float) -> Iterator[Picture]:
    """A figure of this size in inches, in the common style; needs no display."""
    with mpl.rc_context(STYLE):
        yield Picture(figsize=(width, height), layout="constrained")


def save(drawing: Figure, folder: Path, name: str, formats: tuple[str, ...] = ("png",)) -> None:
    """Write a figure as folder/name.png (and .svg)."""
    for suffix in formats:
        drawing.savefig(folder / f"{name}.{suffix}", facecolor="white")


def fix_ticks(axis: Any, places: Sequence[float]) -> None:
    """Set the ticks of a logarithmic axis, written as plain numbers."""
    axis.set_major_locator(FixedLocator(places))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def mark_clipped(image: NDArray[Any], clipped: NDArray[np.bool_]) -> NDArray[np.float64]:
    """A display image in [0, 1] as RGB, with pixels in red that are clipped in any channel."""
    marked = np.array(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2), float)
    marked[clipped if clipped.ndim == 2 else clipped.any(axis=2)] = CLIPPED_COLOUR
    return marked


def panel(axes: Any, image: NDArray[Any], title: str = "", **options: Any) -> Any:
    """Draw an image in a thin frame without ticks; by default grey from 0 to 1."""
    options = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "nearest", **options}
    artist = axes.imshow(image, **options)
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(visible=True, color="0.6", linewidth=0.5)
    return artist


def kinds_panel(axes: Any, kinds: NDArray[np.integer], names: Sequence[str], title: str) -> None:
    """Draw an image of the numbers of at most five kinds, the first usual, beside their names."""
    colours = ListedColormap(("#f2f2f2", "#404040", *COLOURS[:3]))
    norm = BoundaryNorm(np.arange(len(names) + 1) - 0.5, len(names))
    image = panel(axes, kinds, title, cmap=colours, norm=norm, vmin=None, vmax=None)
    scale = axes.inset_axes((1.03, 0, 0.05, 1))
    axes.figure.colorbar(image, cax=scale, ticks=range(len(names))).set_ticklabels(names)
