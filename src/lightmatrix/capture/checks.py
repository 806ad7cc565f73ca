"""What makes frames unreadable, whatever is to be done with them."""

from __future__ import annotations

import numpy as np

from lightmatrix.camera.decoder import Decoder
from lightmatrix.capture.frames import Frames, level_blocks
from lightmatrix.errors import InputError

# The highest levels of cameras of 8, 10, 12 and 14 bits.
_HIGHEST_LEVELS = (255, 1023, 4095, 16383)


def check_depth(frames: Frames, decoder: Decoder) -> None:
    """Refuse 16-bit files that hold fewer bits, while their full range was assumed.

    A camera of 12 bits clips at 4095: with 65535 in its place all samples are below 1/16, none is
    clipped, and an estimate finds nothing without a sign that it is wrong.

    Raises
    ------
    InputError
        Naming the clip level that is probably meant.
    """
    if not decoder.clip_assumed or frames.dtype != np.uint16:
        return
    top = 0
    for block in level_blocks(frames):
        top = max(top, int(block.max()))
        if top > _HIGHEST_LEVELS[-1]:
            return
    likely = next(level for level in _HIGHEST_LEVELS if level >= top)
    raise InputError(
        f"the images have 16 bits, but no level above {top}: a camera that clips at {likely}?",
        hint=f'say --clip {likely}, or "clip" in capture.json; --clip 65535 if they are just dark',
    )


def check_per_frame(decoder: Decoder, count: int) -> None:
    """Refuse lists of exposures or levels that do not have one number a frame.

    Raises
    ------
    InputError
        Naming the list.
    """
    for name in ("clip", "black_level", "exposure"):
        value = np.asarray(getattr(decoder, name))
        if value.ndim and value.shape != (count,):
            raise InputError(
                f"{name} has {value.size} values for {count} frames",
                hint="give one number, or one for each frame",
            )
