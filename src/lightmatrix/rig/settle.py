"""The settle time: how long after a picture is shown a photograph of it may begin.

Black and white alternate while frames are taken. The brightness of each frame shows whether its
exposure began before the change was over.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from lightmatrix.errors import FrameTimeoutError
from lightmatrix.rig.devices.base import same_exposure, set_exposure
from lightmatrix.rig.photograph import (
    FIRST_SETTLE,
    WhiteAndBlack,
    plain_images,
    robust_deviation,
)
from lightmatrix.rig.rig import Rig, UnfitRigError


@dataclass(frozen=True)
class _Watching:
    """How changes between black and white are watched; times are in seconds."""

    # The first changes are watched for the long time, and give a rough settle time. The further
    # ones are watched only as long as that takes, within these bounds.
    first: int = 4
    total: int = 21
    long: float = 0.5
    short: float = 0.15
    # A frame is lost if it comes later than this beyond three times the usual wait.
    lost: float = 0.2
    # A frame has settled if it is nearer to its end than this share of the way from black to white.
    # If the light flickers, so many standard deviations are allowed, but never more than the last.
    settled: float = 0.03
    deviations: float = 4.0
    most_unsettled: float = 0.3
    # This share of the changes may be late or seen by a bad frame without being part of the settle
    # time, and this share may end without a settled frame. Both are well above the 2 % of late
    # images and 4 % of bad frames of a usual rig.
    late: float = 1 / 7
    unseen: float = 0.25


_WATCHING = _Watching()


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
    rig: Rig, whites: WhiteAndBlack, progress: Callable[[int, int], None] | None = None
) -> SettleTime:
    """Find the shortest safe delay between showing a picture and exposing.

    `progress` is called with (done, total) changes. An UnfitRigError says that the picture does not
    settle.
    """
    asked = set_exposure(rig.camera, whites.exposure)
    observer = _Observer(rig, whites)
    looks: list[tuple[float, float]] = []
    duration, total = _WATCHING.long, _WATCHING.total
    for change in range(total):
        if change == _WATCHING.first and looks:
            duration = 2 * max(first for _, first in looks) + 4 * observer.frame_time
            duration = min(max(duration, _WATCHING.short), _WATCHING.long)
        look = observer.look(bool(change % 2), duration)
        if not same_exposure(rig.camera.exposure, asked):
            # Another program has changed the exposure.
            set_exposure(rig.camera, asked)
        elif look is not None:
            looks.append(look)
        if progress is not None:
            progress(change + 1, total)
    if len(looks) < (1 - _WATCHING.unseen) * total:
        raise UnfitRigError(
            f"after {total - len(looks)} of {total} changes between black and white the picture "
            f"had not settled within {duration:.2f} s",
            hint="is the exposure fixed (no automatic exposure or gain), and the room's light "
            "steady? `lightmatrix rig flicker` measures that",
        )
    # Late images and bad frames are no part of the settle time.
    times = np.array(looks)
    last, starts = np.sort(times[:, 0]), times[:, 1]
    ignored = int(_WATCHING.late * total) - (total - len(looks))
    unsettled = float(last[-1 - max(0, ignored)])
    seconds = float(starts[starts > unsettled].min())
    late = total - len(looks) + int((last > seconds).sum())
    if unsettled > 0.8 * _WATCHING.long:
        raise UnfitRigError(
            f"the picture still changes {unsettled:.2f} s after it is shown",
            hint="switch off what delays the picture (compositor, variable refresh, picture "
            "improvement of the projector), or state the settle time in seconds",
        )
    # A frame that saw a little of the change may have counted as settled, and clocks are inaccurate
    # by 2 ms.
    seconds += 0.002 + observer.tolerance * asked
    return SettleTime(round(seconds, 6), unsettled, total, late)


class _Observer:
    """Watches changes between black and white by frames at the exposure of `whites`.

    `tolerance` is how near to its end a settled frame is, as a share of the way from black to
    white; `patience` is in seconds a frame.
    """

    def __init__(self, rig: Rig, whites: WhiteAndBlack) -> None:
        self._rig, self._whites = rig, whites
        self._generator = np.random.default_rng(0)
        refresh = float(rig.projector.info().get("refresh") or 60.0)
        self.frame_time = whites.exposure + 1 / refresh
        shown = rig.projector.show(plain_images(rig)[1])
        rig.clock.sleep(shown + FIRST_SETTLE - rig.clock.now())
        rig.camera.flush()
        levels, waits = [], []
        for _ in range(12):
            asked = rig.clock.now()
            rig.camera.trigger()
            with suppress(FrameTimeoutError):
                frame = rig.camera.get_image(rig.patience + 2 * rig.camera.exposure)
                waits.append(rig.clock.now() - asked)
                levels.append(self._whites.level(frame.data))
        spread = robust_deviation(np.array(levels)) if levels else 0.0
        usual = float(np.median(waits)) if waits else rig.patience
        tolerance = max(_WATCHING.settled, _WATCHING.deviations * spread)
        self.tolerance = min(tolerance, _WATCHING.most_unsettled)
        self.patience = _WATCHING.lost + 3 * usual

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
        # Even the last frame may be lost, and may come a second late.
        latest = shown + duration + 1 + self.patience
        while rig.clock.now() < latest and (not starts or starts[-1] < duration):
            rig.camera.trigger()
            try:
                frame = rig.camera.get_image(self.patience)
            except FrameTimeoutError:
                continue
            starts.append(frame.timestamp - rig.camera.exposure - shown)
            levels.append(self._whites.level(frame.data))
        settled = np.abs(np.array(levels) - (0.0 if dark else 1.0)) < self.tolerance
        if not len(settled) or not settled[-1]:
            return None
        unsettled = np.flatnonzero(~settled)
        times = np.array(starts)
        last = float(times[unsettled[-1]]) if len(unsettled) else -np.inf
        return max(last, 0.0), float(times[times > last].min())
