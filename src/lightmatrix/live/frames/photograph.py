"""One photograph of one image: shown, waited for, grabbed, and trusted only if it can be right.

What can be told from the frame alone, its number and its time is told here: frames that are stale,
lost, handed out twice or mixed with an earlier one, and exposures that another program changed.
Whether a frame shows its pattern is told in `watching.py`.
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

# Frames of before the pattern that are passed over until one of it comes.
_MOST_STALE = 32
# Of the settle time and of clocks: frames begun so much too early are taken.
_TICK = 1e-6
# Logarithm of the probability that rows are alike by chance, below which they were copied.
_COPIED = -20.0
_REMEMBERED = 3


class UntrustedFrameError(DeviceError):
    """A frame that cannot be right, or none at all; it is to be taken again."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame with what it was taken with.

    Parameters
    ----------
    frame : Frame
    exposure : float
        Seconds, as the camera says.
    shown : float
        When the projector showed the image.
    """

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
class Taker:
    """Takes single frames with a rig.

    Parameters
    ----------
    rig : Rig
    settle : float
        Seconds between an image being shown and the earliest start of an exposure.
    changing : (rows,) float, optional
        Share of the samples of each row of a frame that noise changes from frame to frame; where
        it is known, rows that did not change tell of copied frames.
    """

    rig: Rig
    settle: float
    changing: NDArray[np.float64] | None = None
    # What was last set, and what the camera made of it.
    _exposure: tuple[float, float] = (0.0, 0.0)
    _last: Frame | None = None
    _recent: deque[NDArray[Any]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def take(
        self,
        image: NDArray[np.uint8],
        exposure: float | None = None,
        settle: float | None = None,
    ) -> Shot:
        """Show an image and photograph it.

        Parameters
        ----------
        image : (rows, cols) uint8
        exposure : float, optional
            Seconds; None: as the camera is set.
        settle : float, optional
            Seconds, of an image that may be waited for less; None: as for all.

        Raises
        ------
        UntrustedFrameError
            Saying what is wrong with the frame, or that there is none.
        DeviceError
            If the camera was lost and is not back within a minute.
        """
        try:
            return self._take(image, exposure, self.settle if settle is None else settle)
        except (UntrustedFrameError, FrameTimeoutError) as error:
            raise UntrustedFrameError(error.message, hint=error.hint) from error
        except DeviceError as error:
            self.rig.recover()
            # It counts anew, and may have forgotten how it was set.
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
        # Between two patterns frames are thrown away, and numbers may be left out.
        if before is not None and frame.id != before.id + 1:
            # Or else the one that came would be refused with the next pattern.
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
    """How many rows at the top or the bottom of a frame come from an earlier one; 0 for none.

    Parameters
    ----------
    data, earlier : (rows, cols[, channels])
    changing : (rows,) float
        Share of samples that noise changes from frame to frame.
    clip_level : float
        Samples there do not change.
    """
    if data.shape != earlier.shape:
        return 0
    alike = (data == earlier).reshape(len(data), -1)
    same = alike.all(axis=1)
    if not (same[0] or same[-1]):
        return 0
    free = (data < clip_level).reshape(len(data), -1).sum(axis=1)
    unlikely = free * np.log1p(-np.minimum(changing, 0.999))
    for rows in (slice(None), slice(None, None, -1)):
        run = int(np.cumprod(same[rows]).sum())
        if unlikely[rows][:run].sum() < _COPIED:
            return run
    return 0
