"""Raw camera files (DNG, CR2, NEF, ARW, ...) as light: black subtracted, 1 where the sensor clips.

LibRaw reads them without white balance, colour matrix, gamma or brightening, so that the levels of
each channel stay proportional to light.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.reading import check_image_size

RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")


def read_raw(file: Path, *, mosaic: bool = False) -> NDArray[np.float32]:
    """Read a raw file as the sensor lies: (rows, cols) behind a colour filter, or (rows, cols, 3).

    Noise may be below 0. Missing colours are interpolated linearly, so that light still adds up.
    """
    library = raw_library()
    with library.imread(str(file)) as opened:
        rows, cols = opened.sizes.height, opened.sizes.width
        check_image_size(file, (rows, cols, 3))
        flat = opened.raw_type == library.RawType.Flat
        if mosaic and not flat:
            raise InputError(
                f"{file}: holds colours already, no mosaic", hint="leave the option mosaic out"
            )
        black, clip = _levels(file, opened)
        if mosaic:
            colour = np.asarray(opened.raw_colors_visible)
            levels = np.asarray(opened.raw_image_visible, np.float32)
            return ((levels - black[colour]) / (clip - black)[colour]).astype(np.float32)
        span = clip - black
        if flat:
            black, span = _with_one_black(opened, black, span)
        levels = opened.postprocess(
            demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,
            output_color=library.ColorSpace.raw,
            highlight_mode=library.HighlightMode.Clip,
            user_wb=[1, 1, 1, 1],
            gamma=(1, 1),
            output_bps=16,
            no_auto_bright=True,
            no_auto_scale=True,
            # Black is subtracted below: LibRaw would cut off noise that is darker than black.
            user_black=0,
            user_cblack=[0, 0, 0, 0],
            user_flip=0,
        )
        return ((levels - black[:3]) / span[:3]).astype(np.float32)


def raw_library() -> Any:
    """The module rawpy; without it, an error names the extra to install."""
    try:
        import rawpy
    except ImportError as error:
        raise MissingExtraError(
            "raw camera files need LibRaw",
            hint='install the extra: pip install "lightmatrix[raw]"; or develop them linearly to '
            "16-bit TIFF",
        ) from error
    return rawpy


def _with_one_black(
    opened: Any, black: NDArray[np.float32], span: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Give all colours the least black level, since both greens become one; levels and spans."""
    colour = np.asarray(opened.raw_colors_visible)
    colours = np.unique(colour)
    least = black[colours].min()
    above = np.maximum(black - least, 0).astype(np.uint16)
    if above[colours].any():
        levels = opened.raw_image_visible
        levels -= np.minimum(levels, above[colour])
    if 3 in colours:
        span = np.where([False, True, False, True], span[[1, 3]].min(), span)
    return np.full(4, least, np.float32), span


def _levels(file: Path, opened: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Black and clip level of the filter's four colours; the fourth is the second green."""
    black = np.array(opened.black_level_per_channel, np.float32)
    clip = np.full(4, opened.white_level, np.float32)
    # Some cameras say where the sensor clips, if that is before the file's range ends.
    camera_clip = opened.camera_white_level_per_channel
    if camera_clip is not None and min(camera_clip) > 0:
        clip = np.minimum(clip, np.array(camera_clip, np.float32))
    if not (clip > black).all():
        raise InputError(
            f"{file}: says that it is black at {black.max():g} and white at {clip.min():g}",
            hint="convert it to DNG or TIFF by the camera's own program",
        )
    return black, clip
