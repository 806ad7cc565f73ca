"""Pictures of a light transport matrix and of its diagnostics; `lm.show` draws them by name."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from lightmatrix.pictures import style
from lightmatrix.pictures.maps import Map, correspondence_maps, display, light_map, white_level
from lightmatrix.transport.correspondence import correspondence
from lightmatrix.transport.matrix import LightTransport


def draw_row(transport: LightTransport, *camera_index: int) -> style.Picture:
    """How much light each projector pixel sends to one camera sample, beside the scene."""
    transport.row_number(camera_index)  # Refuses a pixel that the camera does not have.
    place = ", ".join(map(str, camera_index))
    if (region := transport.region) is not None:
        down, right = transport.provenance["capture_description"].get("bin_camera", (1, 1))
        row, col = np.add(region.corner, np.multiply(camera_index[:2], (down, right))).tolist()
        place += f"\n(pixel {row}, {col} of the photographs)"
    scene = transport.relight(np.ones(transport.projector_shape, np.float32))
    titles = f"Camera pixel {place}", "Its row of T: the projector"
    return _spot(scene, camera_index, transport.row(*camera_index), titles)


def draw_column(transport: LightTransport, row: int, col: int) -> style.Picture:
    """What the camera sees when one projector pixel is lit: the mean of its channels."""
    titles = f"Projector pixel {row}, {col}, in the dual image", "Its column of T: the camera"
    return _spot(transport.dual_image(), (row, col), _grey(transport.column(row, col)), titles)


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    return image if image.ndim == 2 else image.mean(axis=2)


def _spot(
    scene: NDArray[Any], index: tuple[int, ...], light: NDArray[Any], titles: tuple[str, str]
) -> style.Picture:
    """A pixel in its scene, its light on the other side, and that light around its peak."""
    shown = light_map(light, titles[1])
    peak = np.unravel_index(light.argmax(), light.shape)
    # A usual footprint has a few pixels, and light around it that fades over some more.
    first = [max(int(place) - 10, 0) for place in peak]
    last = [min(int(p) + 10, n - 1) for p, n in zip(peak, light.shape, strict=True)]
    top, left, bottom, right = first[0] - 0.5, first[1] - 0.5, last[0] + 0.5, last[1] + 0.5
    with style.figure(10.2, 3.4) as drawing:
        around, whole, near = drawing.subplots(1, 3)
        style.panel(around, display(_grey(scene), white_level(scene)), titles[0])
        around.plot(index[1], index[0], "o", mfc="none", mec=style.COLOURS[1], ms=10, mew=2)
        draw_into(drawing, whole, shown, bar=False)
        corner, size = (left, top), (right - left, bottom - top)
        whole.add_patch(Rectangle(corner, *size, fill=False, edgecolor="white", linewidth=0.8))
        draw_into(drawing, near, replace(shown, title="Enlarged around its peak"))
        near.set(xlim=(left, right), ylim=(bottom, top), xticks=(first[1], peak[1], last[1]))
        near.set_yticks((first[0], peak[0], last[0]))
    return drawing


def draw_dual(transport: LightTransport) -> style.Picture:
    """The scene as the projector would photograph it, lit evenly from the camera."""
    image = transport.dual_image()
    with style.figure(3.6, 3.6) as drawing:
        title = "Dual image: seen from the projector"
        style.panel(drawing.subplots(), display(image, white_level(image)), title)
    return drawing


def draw_parts(images: Mapping[str, NDArray[Any]]) -> style.Picture:
    """Parts of one photograph by name, faint ones brightened by a power of two."""
    # The level is that of all parts together, since a black part has none of its own.
    whole = white_level(np.stack(list(images.values())))
    with style.figure(3.4 * len(images), 3.6) as drawing:
        for axes, (name, image) in zip(
            drawing.subplots(1, len(images)), images.items(), strict=True
        ):
            # Not more than 64 times, and not darker, as a part may be black.
            factor = 2.0 ** np.clip(np.floor(np.log2(whole / white_level(image))), 0, 6)
            title = f"{name.capitalize()} light"
            title += f", {factor:g} times as bright" if factor > 1 else ""
            style.panel(axes, display(image, whole / factor), title)
    return drawing


def spectrum(transport: LightTransport) -> dict[str, NDArray[Any]]:
    """The 50 largest singular values of T, ``values``."""
    least = min(transport.shape)
    matrix = transport.to_matrix(dense_background=least == 1)
    if least == 1 or not (matrix.nnz or transport.background.any()):
        return {"values": np.array([np.linalg.norm(matrix.data)])}
    linalg, count = scipy.sparse.linalg, min(50, least - 1)
    operator = linalg.aslinearoperator(transport)
    values = linalg.svds(operator, count, v0=np.ones(least), return_singular_vectors=False)
    return {"values": np.sort(values)[::-1]}


def draw_spectrum(transport: LightTransport) -> style.Picture:
    """The largest singular values of T, as shares of the largest."""
    values = spectrum(transport)["values"]
    shares = values / max(float(values[0]), np.finfo(float).tiny)
    with style.figure(4.2, 2.8) as drawing:
        axes = drawing.subplots()
        axes.plot(np.arange(1, len(shares) + 1), shares, "o-", color=style.COLOURS[0], markersize=3)
        axes.set_ylim(0, 1.05)
        axes.set_title(f"Singular values of T: the {len(shares)} largest")
        axes.set_xlabel("number")
        axes.set_ylabel("share of the largest")
        axes.grid(axis="y", color="0.92", linewidth=0.6)
    return drawing


def draw_correspondence(transport: LightTransport) -> style.Picture:
    """The projector pixel that each camera pixel sees most, and how much light comes from it."""
    maps = correspondence_maps(correspondence(transport))
    with style.figure(10.2, 3.4) as drawing:
        for number, (axes, shown) in enumerate(zip(drawing.subplots(1, 3), maps, strict=True)):
            draw_into(drawing, axes, shown)
            # Lines of equal row or column, in eight bands, can be read without colour.
            known = min(shown.values.shape) >= 2 and np.isfinite(shown.values).any()
            if number < 2 and known:
                levels = np.linspace(shown.low, shown.high, 9)[1:-1]
                axes.contour(shown.shown, levels, colors="white", linewidths=0.5)
    return drawing


def draw_map(shown: Map) -> style.Picture:
    """A map with its title and the scale of its colours."""
    with style.figure(4.4, 3.6) as drawing:
        draw_into(drawing, drawing.subplots(), shown)
    return drawing


def draw_into(drawing: Figure, axes: Axes, shown: Map, *, bar: bool = True) -> None:
    """Draw a map, and by default the scale of its colours, into axes."""
    options = {"cmap": shown.colour_map, "norm": shown.norm, "vmin": None, "vmax": None}
    drawn = style.panel(axes, shown.shown, shown.title, **options)
    if bar:
        # The colour bar is as high as the map, whatever the frame's shape.
        scale = axes.inset_axes((1.03, 0, 0.05, 1))
        drawing.colorbar(drawn, cax=scale, label=shown.label)
        if shown.logarithmic:
            decades = 10.0 ** np.arange(np.ceil(np.log10(shown.low)), np.log10(shown.high) + 0.01)
            style.fix_ticks(scale.yaxis, decades.tolist())
