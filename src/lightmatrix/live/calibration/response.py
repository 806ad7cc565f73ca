"""The projector's response: the light it gives for each grey value, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.live.calibration.white import Whites, find_white
from lightmatrix.live.rig import Rig
from lightmatrix.live.steady import take_steady
from lightmatrix.live.taking import Taker

_STEPS = 17
# Of white: darker steps say little of the exponent.
_FAINT = 0.02


@dataclass(frozen=True)
class ProjectorResponse:
    """Light of grey values.

    Parameters
    ----------
    levels : tuple of int
        Grey values, from 0 to 255.
    light : tuple of float
        Light of each, from 0 to 1; never decreasing.
    gamma : float
        The power of the grey value that comes nearest.
    """

    levels: tuple[int, ...]
    light: tuple[float, ...]
    gamma: float

    def grey_for(self, light: NDArray[np.floating]) -> NDArray[np.uint8]:
        """Grey values (uint8) that give the wanted light, in [0, 1]."""
        # Between the steps the curve is nearly straight in this measure, but not in light itself.
        bent = np.asarray(self.light) ** (1 / self.gamma)
        wanted = np.asarray(light, np.float64) ** (1 / self.gamma)
        return np.rint(np.interp(wanted, bent, self.levels)).astype(np.uint8)


def measure_response(
    rig: Rig,
    *,
    settle: float,
    whites: Whites | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorResponse:
    """Measure how much light the projector gives for each grey value.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds; see `measure_settle`.
    whites : Whites, optional
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
    taker = Taker(rig, settle)
    whites = whites or find_white(taker)
    levels = np.rint(np.linspace(0, 255, _STEPS)).astype(int)
    light = np.empty(_STEPS)
    for k, level in enumerate(levels):
        image = np.full(rig.projector.shape, level, np.uint8)
        light[k] = whites.level(take_steady(taker, image, whites.exposure, 3).mean)
        if progress is not None:
            progress(k + 1, _STEPS)
    light = (light - light[0]) / (light[-1] - light[0])
    light = np.maximum.accumulate(np.clip(light, 0, 1))
    clear = (light > _FAINT) & (light < 1)
    bent, value = np.log(light[clear]), np.log(levels[clear] / 255)
    gamma = float(np.clip((bent @ value) / (value @ value), 0.1, 10)) if clear.any() else 1.0
    return ProjectorResponse(tuple(map(int, levels)), tuple(map(float, light)), gamma)
