"""The settle time: how long after a picture is shown a photograph of it may begin.

Black and white alternate, and frames are taken all the while. Each tells by its brightness whether
its exposure began before the change was over.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.devices.exposures import same_exposure, set_exposure
from lightmatrix.live.frames.photograph import Taker
from lightmatrix.live.measurements.white import FIRST_SETTLE, Whites, find_white, images
from lightmatrix.live.rig import Rig, UnfitRigError

# Changes with a long look each, that find about when; further ones with a short look.
_FIRST, _FURTHER = 4, 17
_LONG_LOOK, _SHORT_LOOK = 0.5, 0.15
# A camera that gives no frame for so long, beyond three times the usual, has lost it.
_LOST = 0.2
# Seconds that the last frame of a look may come late.
_LAST_FRAME = 1.0
# Of the way from black to white: what is nearer to its end has settled.
_SETTLED = 0.03
# Where the light flickers: so many standard deviations, but never more than this.
_DEVIATIONS, _MOST_UNSETTLED = 4.0, 0.3
_STEADY_FRAMES = 12
# Seconds added to what was measured, for clocks.
_MARGIN = 0.002
# Of the changes: more that come late, or are seen by a bad frame, are part of the settle time.
_MOST_LATE = 1 / 7
# And more without a settled frame at their end mean that nothing settles.
_MOST_LOST = 0.25


@dataclass(frozen=True)
class SettleTime:
    """How long to wait between showing and exposing.

    Parameters
    ----------
    seconds : float
        From the projector's saying that it shows to the earliest start of an exposure.
    unsettled : float
        The latest start of an exposure, after the same moment, that still saw the change.
    changes : int
        Changes between black and white that were looked at.
    late : int
        How many of them came much later than the others.
    """

    seconds: float
    unsettled: float
    changes: int
    late: int


def measure_settle(
    rig: Rig,
    *,
    exposure: float | None = None,
    whites: Whites | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SettleTime:
    """Find the shortest safe delay between showing a picture and exposing.

    Parameters
    ----------
    rig : Rig
    exposure : float, optional
        Seconds; the shorter, the sharper. None: chosen by a white picture, at most a refresh.
    whites : Whites, optional
        White and black frame, if they are known already.
    progress : callable, optional
        Called with (done, total) changes.

    Returns
    -------
    SettleTime

    Raises
    ------
    DeviceError
        If the camera does not see the projector, or the picture does not settle.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:procedural,size=16,delay=3,real=0") as rig:
    ...     settle = lm.measure_settle(rig)
    >>> 3 / 60 <= settle.seconds < 4 / 60
    True
    """
    taker = Taker(rig, FIRST_SETTLE)
    if whites is None:
        if exposure is not None:
            set_exposure(rig.camera, exposure)
        whites = find_white(taker)
    asked = set_exposure(rig.camera, whites.exposure if exposure is None else exposure)
    scale = asked / whites.exposure
    generator = np.random.default_rng(0)
    settled, patience = _tolerance(rig, whites, scale)
    looks: list[tuple[float, float]] = []
    duration = _LONG_LOOK
    total = _FIRST + _FURTHER
    for change in range(total):
        if change == _FIRST and looks:
            duration = 2 * max(first for _, first in looks) + 4 * _frame_time(rig, whites.exposure)
            duration = min(max(duration, _SHORT_LOOK), _LONG_LOOK)
        look = _look(rig, whites, scale, settled, patience, bool(change % 2), duration, generator)
        if not same_exposure(rig.camera.exposure, asked):
            # Another program has changed it.
            set_exposure(rig.camera, asked)
        elif look is not None:
            looks.append(look)
        if progress is not None:
            progress(change + 1, total)
    if len(looks) < (1 - _MOST_LOST) * total:
        raise UnfitRigError(
            f"after {total - len(looks)} of {total} changes between black and white the picture "
            f"had not settled within {duration:.2f} s",
            hint="is the exposure fixed (no automatic exposure or gain), and the room's light "
            "steady? lightmatrix rig flicker",
        )
    # A frame that saw a little of the change may still have passed for settled.
    return _settle_time(np.array(looks), total, _MARGIN + settled * asked)


def _tolerance(rig: Rig, whites: Whites, scale: float) -> tuple[float, float]:
    """How near to white a settled frame is, and how long to wait for one.

    White is looked at for a while.
    """
    shown = rig.projector.show(images(rig)[1])
    rig.clock.sleep(shown + FIRST_SETTLE - rig.clock.now())
    rig.camera.flush()
    levels, waits = [], []
    for _ in range(_STEADY_FRAMES):
        asked = rig.clock.now()
        rig.camera.trigger()
        with suppress(FrameTimeoutError):
            frame = rig.camera.get_image(rig.patience + 2 * rig.camera.exposure)
            waits.append(rig.clock.now() - asked)
            levels.append(whites.level(_as_exposed(frame.data, whites, scale)))
    # By medians: one of the frames may be a copy of an earlier one.
    apart = np.abs(np.array(levels) - np.median(levels)) if levels else np.zeros(1)
    spread = 1.48 * float(np.median(apart))
    usual = float(np.median(waits)) if waits else rig.patience
    return min(max(_SETTLED, _DEVIATIONS * spread), _MOST_UNSETTLED), _LOST + 3 * usual


def _frame_time(rig: Rig, exposure: float) -> float:
    return exposure + 1 / float(rig.projector.info().get("refresh") or 60.0)


def _look(
    rig: Rig,
    whites: Whites,
    scale: float,
    tolerance: float,
    patience: float,
    dark: bool,
    duration: float,
    generator: np.random.Generator,
) -> tuple[float, float] | None:
    """Start of the last exposure that saw one change, and of the first after it; seconds.

    None if the last frame has not settled: of a late picture, or a frame that is no good.
    """
    black, white = images(rig)
    old, new = (white, black) if dark else (black, white)
    shown = rig.projector.show(old)
    rig.clock.sleep(shown + min(FIRST_SETTLE, duration) - rig.clock.now())
    # At any moment of the camera's and the projector's own rhythm.
    rig.clock.sleep(float(generator.random()) * 2 * _frame_time(rig, whites.exposure))
    rig.camera.flush()
    shown = rig.projector.show(new)
    starts: list[float] = []
    levels: list[float] = []
    # Frames may be lost, the last one too.
    latest = shown + duration + _LAST_FRAME + patience
    while rig.clock.now() < latest and (not starts or starts[-1] < duration):
        rig.camera.trigger()
        try:
            frame = rig.camera.get_image(patience)
        except FrameTimeoutError:
            continue
        starts.append(frame.timestamp - rig.camera.exposure - shown)
        levels.append(whites.level(_as_exposed(frame.data, whites, scale)))
    settled = np.abs(np.array(levels) - (0.0 if dark else 1.0)) < tolerance
    if not len(settled) or not settled[-1]:
        return None
    unsettled = np.flatnonzero(~settled)
    times = np.array(starts)
    last = float(times[unsettled[-1]]) if len(unsettled) else -np.inf
    later = times[times > last]
    return max(last, 0.0), float(later.min())


def _as_exposed(data: NDArray[np.generic], whites: Whites, scale: float) -> NDArray[np.floating]:
    """A frame as it would be at the exposure of the white one."""
    if scale == 1:
        return np.asarray(data, np.float32)
    return (np.asarray(data, np.float32) - whites.black.mean) / scale + whites.black.mean


def _settle_time(looks: NDArray[np.float64], changes: int, margin: float) -> SettleTime:
    # Pictures that came late, and frames that were no good, are no part of the settle time.
    last = np.sort(looks[:, 0])
    ignored = int(_MOST_LATE * changes) - (changes - len(looks))
    unsettled = float(last[-1 - max(0, ignored)])
    starts = looks[:, 1]
    seconds = float(starts[starts > unsettled].min())
    late = changes - len(looks) + int((last > seconds).sum())
    if unsettled > 0.8 * _LONG_LOOK:
        raise UnfitRigError(
            f"the picture still changes {unsettled:.2f} s after it is shown",
            hint="switch off what delays the picture (compositor, variable refresh, picture "
            "improvement of the projector), or say how long to wait: --settle SECONDS",
        )
    return SettleTime(round(seconds + margin, 6), unsettled, changes, late)
