"""The time by which a rig lives: the system's, or a simulated one that passes without waiting."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """The time in seconds, as `time.monotonic` counts them."""

    def sleep(self, seconds: float) -> None:
        """Wait; not at all unless the seconds are above 0."""


@dataclass(frozen=True)
class SystemClock:
    """The system's clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            time.sleep(seconds)


@dataclass
class SimulatedClock:
    """A clock that jumps instead of waiting: an hour of a virtual rig passes in seconds."""

    seconds: float = 0.0

    def now(self) -> float:
        return self.seconds

    def sleep(self, seconds: float) -> None:
        self.seconds += max(0.0, seconds)
