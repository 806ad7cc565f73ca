"""Whether a photograph can be right, judged by its number, its time and its rows alone.

A `Photographer` shows an image, waits, and grabs a frame. It rejects frames that are stale, lost,
handed out twice or partly copied from an earlier one, and exposures that another program changed.
Whether a frame shows its pattern is a question for `pattern_match`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.live.devices.exposures import same_exposure, set_exposure
from lightmatrix.live.devices.protocols import Frame
from lightmatrix.live.rig import Rig

# At most this many frames from before the pattern are skipped until one under it arrives. Chosen by
# hand: it is more than any camera buffers.
_MOST_STALE = 32
# A frame may begin this many seconds before the settle time is over: times are rounded.
_TICK = 1e-6
# Rows are copies of an earlier frame's if the natural logarithm of the probability that noise left
# them equal is below this, so that chance does it less than once in 10^8 frames.
_COPIED = -20.0
# Each frame is compared with this many earlier ones: drivers reuse their few newest buffers.
_REMEMBERED = 3


class UntrustedFrameError(DeviceError):
    """A frame cannot be right, or none arrived; the photograph has to be taken again."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame, its exposure in seconds as the camera says, and when the image was shown."""

    frame: Frame
    exposure: float
    shown: float

    @property
    def data(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Raw levels."""
        return self.frame.data

    @property
    def delay(self) -> float:
        """Seconds from the image being shown to the start of the exposure."""
        return self.frame.timestamp - self.exposure - self.shown


@dataclass(eq=False)
class Photographer:
    """Takes single photographs with a rig."""

    rig: Rig
    # Seconds between an image being shown and the earliest start of an exposure.
    settle: float
    # Share of the samples of each row that noise changes from frame to frame. If it is known,
    # copied rows are recognized.
    changing: NDArray[np.float64] | None = None
    # The exposure that was last asked for, and what the camera made of it.
    _exposure: tuple[float, float] = (0.0, 0.0)
    _last: Frame | None = None
    _recent: deque[NDArray[Any]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def take(
        self,
        image: NDArray[np.uint8],
        exposure: float | None = None,
        settle: float | None = None,
    ) -> Shot:
        """Show an image and photograph it (exposure and settle time in seconds; None: as set).

        An UntrustedFrameError says what is wrong with the frame; a DeviceError means that the
        camera was lost and is not back within a minute.
        """
        try:
            return self._take(image, exposure, self.settle if settle is None else settle)
        except (UntrustedFrameError, FrameTimeoutError) as error:
            raise UntrustedFrameError(error.message, hint=error.hint) from error
        except DeviceError as error:
            self.rig.recover()
            # The camera counts from the beginning, and may have forgotten its exposure.
            self._last, self._exposure = None, (0.0, 0.0)
            raise UntrustedFrameError(f"{error.message}, and came back") from error

    def _take(self, image: NDArray[np.uint8], exposure: float | None, settle: float) -> Shot:
        actual = self._set_exposure(exposure)
        shown = self.rig.projector.show(image)
        earliest = shown + settle
        self.rig.clock.sleep(earliest - self.rig.clock.now())
        camera = self.rig.camera
        camera.flush()
        camera.trigger()
        before: Frame | None = None
        for _ in range(_MOST_STALE):
            frame = camera.get_image(self.rig.patience + 2 * actual)
            self._check_order(frame, before)
            self._check_copied(frame)
            self._recent.append(frame.data)
            self._last = before = frame
            if frame.timestamp - actual >= earliest - _TICK:
                self._check_exposure(actual)
                return Shot(frame, actual, shown)
        raise UntrustedFrameError(
            f"{_MOST_STALE} frames came, all of before the pattern",
            hint="are the camera's timestamps right?",
        )

    def _set_exposure(self, exposure: float | None) -> float:
        camera = self.rig.camera
        asked, actual = self._exposure
        if exposure is None:
            return camera.exposure
        if exposure != asked or not same_exposure(camera.exposure, actual):
            self._exposure = exposure, set_exposure(camera, exposure)
        return self._exposure[1]

    def _check_exposure(self, actual: float) -> None:
        now = self.rig.camera.exposure
        if not same_exposure(now, actual):
            raise UntrustedFrameError(
                f"another program changed the exposure from {actual:g} to {now:g} s"
            )

    def _check_order(self, frame: Frame, before: Frame | None) -> None:
        last = self._last
        if last is None:
            return
        if frame.id <= last.id or frame.timestamp <= last.timestamp:
            raise UntrustedFrameError(f"frame {frame.id} was handed out twice")
        # Numbers may be missing between two patterns, where frames are discarded.
        if before is not None and frame.id != before.id + 1:
            # Otherwise the next pattern would be refused for the same gap.
            self._last = frame
            raise UntrustedFrameError(f"frames {before.id + 1} to {frame.id - 1} were lost")

    def _check_copied(self, frame: Frame) -> None:
        if self.changing is None:
            return
        for earlier in self._recent:
            rows = copied_rows(frame.data, earlier, self.changing, frame.clip_level)
            if rows:
                self._last = frame
                whole = rows == len(frame.data)
                what = "is a copy of" if whole else f"holds {rows} rows of"
                raise UntrustedFrameError(f"frame {frame.id} {what} an earlier one")


def copied_rows(
    data: NDArray[Any],
    earlier: NDArray[Any],
    changing: NDArray[np.float64],
    clip_level: float,
) -> int:
    """How many rows at the top or bottom of a frame are copies of an earlier frame's; 0 for none.

    Noise changes a share `changing` (rows,) of the samples of each row, except clipped ones.
    """
    if data.shape != earlier.shape:
        return 0
    same = (data == earlier).reshape(len(data), -1).all(axis=1)
    if not (same[0] or same[-1]):
        return 0
    free = (data < clip_level).reshape(len(data), -1).sum(axis=1)
    unlikely = free * np.log1p(-np.minimum(changing, 0.999))
    for rows in (slice(None), slice(None, None, -1)):
        run = int(np.cumprod(same[rows]).sum())
        if unlikely[rows][:run].sum() < _COPIED:
            return run
    return 0
