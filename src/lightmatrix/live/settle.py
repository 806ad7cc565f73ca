"""The settle time: how long after a picture is shown a photograph of it may begin.

Black and white alternate while frames are taken. The brightness of each frame shows whether its
exposure began before the change was over.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.live.devices.base import same_exposure, set_exposure
from lightmatrix.live.photograph import (
    FIRST_SETTLE,
    Photographer,
    WhiteAndBlack,
    find_white_and_black,
    plain_images,
)
from lightmatrix.live.rig import Rig, UnfitRigError

# The first changes between black and white are looked at for the long time, in seconds, and give a
# rough settle time. The further ones are looked at only as long as that takes, within these bounds.
_FIRST, _FURTHER = 4, 17
_LONG_LOOK, _SHORT_LOOK = 0.5, 0.15
# A frame is lost if it does not come within this many seconds beyond three times the usual wait.
_LOST = 0.2
# Seconds that the last frame of a look may come late.
_LAST_FRAME = 1.0
# A frame has settled if it is nearer to its end than this share of the way from black to white. If
# the light flickers, so many standard deviations are allowed, but never more than the last share.
# Chosen by hand.
_SETTLED = 0.03
_DEVIATIONS, _MOST_UNSETTLED = 4.0, 0.3
# Frames of white that measure how far the light flickers.
_STEADY_FRAMES = 12
# Seconds added to the settle time, for the inaccuracy of clocks.
_MARGIN = 0.002
# This share of the changes may be late or seen by a bad frame without being part of the settle
# time. Chosen by hand, well above the 2 % of late images and 4 % of bad frames of a virtual rig.
_MOST_LATE = 1 / 7
# Nothing settles if more than this share of the changes ends without a settled frame.
_MOST_LOST = 0.25
# The picture settles too late if it still changes after this share of the long look.
_TOO_LATE = 0.8


@dataclass(frozen=True)
class SettleTime:
    """How long to wait between showing and exposing."""

    # From the moment at which the image is shown to the earliest start of an exposure.
    seconds: float
    # The latest start of an exposure, after the same moment, that still saw the change.
    unsettled: float
    # Number of changes between black and white.
    changes: int
    # Number of changes that came much later than the others.
    late: int


def measure_settle(
    rig: Rig,
    *,
    exposure: float | None = None,
    whites: WhiteAndBlack | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SettleTime:
    """Find the shortest safe delay between showing a picture and exposing.

    Parameters
    ----------
    rig : Rig
    exposure : float, optional
        Seconds; the shorter, the sharper. None: chosen by a white picture, at most a refresh.
    whites : WhiteAndBlack, optional
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
    if whites is None:
        if exposure is not None:
            set_exposure(rig.camera, exposure)
        whites = find_white_and_black(Photographer(rig, FIRST_SETTLE))
    asked = set_exposure(rig.camera, whites.exposure if exposure is None else exposure)
    observer = _Observer(rig, whites, asked / whites.exposure)
    looks: list[tuple[float, float]] = []
    duration = _LONG_LOOK
    total = _FIRST + _FURTHER
    for change in range(total):
        if change == _FIRST and looks:
            duration = 2 * max(first for _, first in looks) + 4 * observer.frame_time
            duration = min(max(duration, _SHORT_LOOK), _LONG_LOOK)
        look = observer.look(bool(change % 2), duration)
        if not same_exposure(rig.camera.exposure, asked):
            # Another program has changed the exposure.
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
    # A frame that saw a little of the change may have counted as settled.
    return _settle_time(np.array(looks), total, _MARGIN + observer.tolerance * asked)


class _Observer:
    """Watches changes between black and white by frames at `scale` times the exposure of `whites`.

    `tolerance` is how near to its end a settled frame is, as a share of the way from black to
    white; `patience` is in seconds a frame.
    """

    def __init__(self, rig: Rig, whites: WhiteAndBlack, scale: float) -> None:
        self._rig, self._whites, self._scale = rig, whites, scale
        self._generator = np.random.default_rng(0)
        refresh = float(rig.projector.info().get("refresh") or 60.0)
        self.frame_time = whites.exposure + 1 / refresh
        self.tolerance, self.patience = self._observe_white()

    def _observe_white(self) -> tuple[float, float]:
        rig = self._rig
        shown = rig.projector.show(plain_images(rig)[1])
        rig.clock.sleep(shown + FIRST_SETTLE - rig.clock.now())
        rig.camera.flush()
        levels, waits = [], []
        for _ in range(_STEADY_FRAMES):
            asked = rig.clock.now()
            rig.camera.trigger()
            with suppress(FrameTimeoutError):
                frame = rig.camera.get_image(rig.patience + 2 * rig.camera.exposure)
                waits.append(rig.clock.now() - asked)
                levels.append(self._level(frame.data))
        # Medians, since one of the frames may be a copy of an earlier one.
        apart = np.abs(np.array(levels) - np.median(levels)) if levels else np.zeros(1)
        spread = 1.48 * float(np.median(apart))
        usual = float(np.median(waits)) if waits else rig.patience
        return min(max(_SETTLED, _DEVIATIONS * spread), _MOST_UNSETTLED), _LOST + 3 * usual

    def look(self, dark: bool, duration: float) -> tuple[float, float] | None:
        """Seconds to the last exposure that saw a change and to the next; None if unsettled."""
        rig = self._rig
        black, white = plain_images(rig)
        old, new = (white, black) if dark else (black, white)
        shown = rig.projector.show(old)
        rig.clock.sleep(shown + min(FIRST_SETTLE, duration) - rig.clock.now())
        # The change comes at a random moment of the camera's and the projector's own rhythm.
        rig.clock.sleep(float(self._generator.random()) * 2 * self.frame_time)
        rig.camera.flush()
        shown = rig.projector.show(new)
        starts: list[float] = []
        levels: list[float] = []
        # Even the last frame may be lost.
        latest = shown + duration + _LAST_FRAME + self.patience
        while rig.clock.now() < latest and (not starts or starts[-1] < duration):
            rig.camera.trigger()
            try:
                frame = rig.camera.get_image(self.patience)
            except FrameTimeoutError:
                continue
            starts.append(frame.timestamp - rig.camera.exposure - shown)
            levels.append(self._level(frame.data))
        settled = np.abs(np.array(levels) - (0.0 if dark else 1.0)) < self.tolerance
        if not len(settled) or not settled[-1]:
            return None
        unsettled = np.flatnonzero(~settled)
        times = np.array(starts)
        last = float(times[unsettled[-1]]) if len(unsettled) else -np.inf
        return max(last, 0.0), float(times[times > last].min())

    def _level(self, data: NDArray[np.generic]) -> float:
        """How far a frame is from black to white, as if it were exposed like these."""
        frame = np.asarray(data, np.float32)
        if self._scale != 1:
            black = self._whites.black.mean
            frame = (frame - black) / self._scale + black
        return self._whites.level(frame)


def _settle_time(looks: NDArray[np.float64], changes: int, margin: float) -> SettleTime:
    # Late images and bad frames are no part of the settle time.
    last = np.sort(looks[:, 0])
    ignored = int(_MOST_LATE * changes) - (changes - len(looks))
    unsettled = float(last[-1 - max(0, ignored)])
    starts = looks[:, 1]
    seconds = float(starts[starts > unsettled].min())
    late = changes - len(looks) + int((last > seconds).sum())
    if unsettled > _TOO_LATE * _LONG_LOOK:
        raise UnfitRigError(
            f"the picture still changes {unsettled:.2f} s after it is shown",
            hint="switch off what delays the picture (compositor, variable refresh, picture "
            "improvement of the projector), or say how long to wait: --settle SECONDS",
        )
    return SettleTime(round(seconds + margin, 6), unsettled, changes, late)
