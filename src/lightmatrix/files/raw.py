"""Raw camera files (DNG, CR2, NEF, ARW, ...) as light: black subtracted, 1 where the sensor clips.

Read by LibRaw. No white balance, no colour matrix, no gamma, no brightening: levels stay
proportional to light in each channel by itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.image_size import check_size

RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")


def read_raw(file: Path, *, mosaic: bool = False) -> NDArray[np.float32]:
    """Read a raw camera file.

    Parameters
    ----------
    file : Path
        The file.
    mosaic : bool
        Whether each pixel stays what it is, a sample behind one colour of the filter. Otherwise the
        colours in between are interpolated, linearly, so that light still adds up.

    Returns
    -------
    (rows, cols, 3) or, as a mosaic, (rows, cols) float32
        As the sensor lies, not turned. Noise may be below 0.

    Raises
    ------
    InputError
        On files of several shots or without a mosaic where one is asked for.
    MissingExtraError
        Without the extra `raw`.
    """
    library = _library()
    with library.imread(str(file)) as opened:
        rows, cols = opened.sizes.height, opened.sizes.width
        check_size(file, (rows, cols, 3))
        flat = opened.raw_type == library.RawType.Flat
        if mosaic and not flat:
            raise InputError(
                f"{file}: holds colours already, no mosaic", hint="leave the option mosaic out"
            )
        black, clip = _levels(file, opened)
        if mosaic:
            place = np.asarray(opened.raw_colors_visible)
            levels = np.asarray(opened.raw_image_visible, np.float32)
            return ((levels - black[place]) / (clip - black)[place]).astype(np.float32)
        span = clip - black
        if flat:
            black, span = _as_three(opened, black, span)
        levels = opened.postprocess(
            demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,
            output_color=library.ColorSpace.raw,
            highlight_mode=library.HighlightMode.Clip,
            user_wb=[1, 1, 1, 1],
            gamma=(1, 1),
            output_bps=16,
            no_auto_bright=True,
            no_auto_scale=True,
            # Subtracted here: LibRaw would cut off what noise makes darker than black.
            user_black=0,
            user_cblack=[0, 0, 0, 0],
            user_flip=0,
        )
        return ((levels - black[:3]) / span[:3]).astype(np.float32)


def _as_three(
    opened: Any, black: NDArray[np.float32], span: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Give all colours the least black level, in the opened file too: both greens become one.

    Returns the black levels and, from them to where a colour clips, the spans.
    """
    place = np.asarray(opened.raw_colors_visible)
    colours = np.unique(place)
    least = black[colours].min()
    above = np.maximum(black - least, 0).astype(np.uint16)
    if above[colours].any():
        levels = opened.raw_image_visible
        levels -= np.minimum(levels, above[place])
    if 3 in colours:
        span = np.where([False, True, False, True], span[[1, 3]].min(), span)
    return np.full(4, least, np.float32), span


def shutter_time(file: Path) -> float | None:
    """Exposure time of a raw file in seconds; None if it does not say."""
    try:
        with _library().imread(str(file)) as opened:
            seconds = float(opened.other.shutter_speed)
    except MissingExtraError:
        raise
    # A damaged file says so when it is read in its turn.
    except Exception:
        return None
    return seconds if 0 < seconds < 1e5 else None


def _levels(file: Path, opened: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Black and clip level of the filter's four colours; the fourth is the second green."""
    black = np.array(opened.black_level_per_channel, np.float32)
    clip = np.full(4, opened.white_level, np.float32)
    # Where a sensor clips before the file's range ends, some cameras say so.
    told = opened.camera_white_level_per_channel
    if told is not None and min(told) > 0:
        clip = np.minimum(clip, np.array(told, np.float32))
    if not (clip > black).all():
        raise InputError(
            f"{file}: says that it is black at {black.max():g} and white at {clip.min():g}",
            hint="convert it to DNG or TIFF by the camera's own program",
        )
    return black, clip


def _library() -> Any:
    try:
        import rawpy
    except ImportError as error:
        raise MissingExtraError(
            "raw camera files need LibRaw",
            hint='install the extra: pip install "lightmatrix[raw]"; or develop them linearly to '
            "16-bit TIFF",
        ) from error
    return rawpy
