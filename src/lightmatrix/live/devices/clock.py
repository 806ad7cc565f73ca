"""Time as the live rig reads it: the system's, or one that passes without waiting."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """Seconds of `time.monotonic`, or of a clock that stands in its place."""

    def sleep(self, seconds: float) -> None:
        """Wait; not at all where the seconds are not above 0."""


@dataclass(frozen=True)
class SystemClock:
    """The real one."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)


@dataclass
class SimulatedClock:
    """Waits in no time: an hour of a virtual rig passes in seconds.

    Parameters
    ----------
    seconds : float
        The time it begins at.
    """

    seconds: float = 0.0

    def now(self) -> float:
        return self.seconds

    def sleep(self, seconds: float) -> None:
        self.seconds += max(0.0, seconds)
