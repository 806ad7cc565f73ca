"""Which measurements of a rig no longer hold, found by a short look at the rig."""

from __future__ import annotations

import numpy as np

from lightmatrix.live.frames.photograph import Photographer, UntrustedFrameError
from lightmatrix.live.frames.repeats import take_average
from lightmatrix.live.measurements.flicker import flicker_has_grown
from lightmatrix.live.measurements.rig_measurements import RigMeasurements
from lightmatrix.live.measurements.white_and_black import (
    FIRST_SETTLE,
    WhiteAndBlack,
    plain_images,
    take_white_and_black,
)
from lightmatrix.live.rig import Rig

# The exposures are outdated if the brightness changed by more than this share. Chosen by hand.
_SAME_LIGHT = 0.05
# The responses are outdated if a middle grey changed by more than this share of the way from black
# to white. Chosen by hand.
_SAME_GREY = 0.03
# The settle time is outdated if, of so many changes between black and white, more than the second
# number are farther from their end than the last share. Single late images are normal.
_CHANGES, _MOST_LATE, _NEAR = 6, 2, 0.05


def outdated_parts(rig: Rig, known: RigMeasurements) -> list[str]:
    """Names of the parts that no longer hold; `known` has a settle time and exposures."""
    # Each look begins anew if the camera is lost: some cameras have memory for a few pictures only.
    whites, parts = rig.persistently(lambda: _changed_levels(rig, known))
    assert known.settle is not None
    settle, flicker = known.settle.seconds, known.flicker
    if flicker is not None and rig.persistently(
        lambda: flicker_has_grown(rig, flicker, settle=settle, whites=whites)
    ):
        # Exposures are multiples of the period of a flicker.
        parts += [part for part in ("flicker", "exposure") if part not in parts]
    return parts


def _changed_levels(rig: Rig, known: RigMeasurements) -> tuple[WhiteAndBlack, list[str]]:
    """White and black, and the parts that the levels of frames show to be outdated."""
    assert known.settle is not None
    assert known.exposure is not None
    exposure = known.exposure.seconds[-1]
    whites = take_white_and_black(Photographer(rig, FIRST_SETTLE), exposure)
    parts = []
    photographer = Photographer(rig, known.settle.seconds)
    late = 0
    for change in range(_CHANGES):
        image = plain_images(rig)[change % 2]
        try:
            level = whites.level(photographer.take(image, exposure).data)
        except UntrustedFrameError:
            continue
        late += not abs(level - change % 2) < _NEAR
    if late > _MOST_LATE:
        parts.append("settle")
    if known.response is not None:
        grey = known.response.grey_for(np.array([0.5]))[0]
        light = float(np.interp(grey, known.response.levels, known.response.light))
        image = np.full_like(plain_images(rig)[0], grey)
        shown = take_average(photographer, image, exposure, 3)
        if abs(whites.level(shown.mean) - light) > _SAME_GREY:
            # The projector's curve has changed, or the camera's.
            parts += ["response", "linearity"]
    if abs(whites.brightness / known.brightness - 1) > _SAME_LIGHT:
        # The aperture, the distance, the scene or the lamp has changed.
        parts.append("exposure")
    return whites, parts
