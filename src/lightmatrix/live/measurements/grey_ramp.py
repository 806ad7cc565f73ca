"""The projector's response: how much light it gives for each grey value."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lightmatrix.live.frames.photograph import Photographer
from lightmatrix.live.frames.repeats import take_average
from lightmatrix.live.measurements.white_and_black import WhiteAndBlack, find_white_and_black
from lightmatrix.live.rig import Rig
from lightmatrix.patterns.projector_curve import ProjectorResponse

# Grey values that are photographed, evenly from 0 to 255: a smooth curve is known between them.
_STEPS = 17


def measure_response(
    rig: Rig,
    *,
    settle: float,
    whites: WhiteAndBlack | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    whites : WhiteAndBlack, optional
        White and black frame, if they are known already.
    progress : callable, optional
        Called with (done, total) grey values.

    Returns
    -------
    ProjectorResponse

    Raises
    ------
    DeviceError
        If the camera does not see the projector.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,gamma=2.2,real=0") as rig:
    ...     response = lm.measure_response(rig, settle=0.05)
    >>> round(response.gamma, 1), int(response.grey_for(np.array([0.5]))[0])
    (2.2, 186)
    """
    photographer = Photographer(rig, settle)
    whites = whites or find_white_and_black(photographer)
    levels = np.rint(np.linspace(0, 255, _STEPS)).astype(int)
    light = np.empty(_STEPS)
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        light[k] = whites.level(take_average(photographer, image, whites.exposure, 3).mean)
        if progress is not None:
            progress(k + 1, _STEPS)
    return ProjectorResponse.of_light(levels, light)
