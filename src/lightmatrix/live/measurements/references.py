"""The black and white references of a capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.frames.photograph import Photographer
from lightmatrix.live.frames.repeats import take_average
from lightmatrix.live.frames.same_light import References
from lightmatrix.live.measurements.white_and_black import FIRST_SETTLE, plain_images
from lightmatrix.live.rig import UnfitRigError

# Frames that are averaged for the black frame, whose noise enters all samples alike, for black at
# the shortest exposure, and for white. Chosen by hand.
_BLACK_FRAMES, _SHORT_BLACK_FRAMES, _WHITE_FRAMES = 8, 3, 5
# The rig is unfit if white is not above black by this share of the clip level.
_VISIBLE = 0.01


def take_references(photographer: Photographer, seconds: NDArray[np.float64]) -> References:
    """Photograph black at the longest and white at the shortest of the exposures `seconds`."""
    black, white = plain_images(photographer.rig)
    long, short = float(seconds.max()), float(seconds.min())
    # The first frames wait longer, so that nothing of an earlier image is left.
    waiting = replace(photographer, settle=FIRST_SETTLE)
    dark = dark_short = take_average(waiting, black, long, _BLACK_FRAMES)
    if short != long:
        dark_short = take_average(photographer, black, short, _SHORT_BLACK_FRAMES)
    waiting = replace(photographer, settle=FIRST_SETTLE)
    bright = take_average(waiting, white, short, _WHITE_FRAMES)
    references = References(dark, bright, dark_short.mean)
    if np.quantile(references.light, 0.99) < _VISIBLE * bright.clip_level:
        raise UnfitRigError(
            f"at {short:g} s, a white picture looks like a black one",
            hint="leave --exposure to be measured, or choose one at which white neither clips nor "
            "is dark",
        )
    return references
