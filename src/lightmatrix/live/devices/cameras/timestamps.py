"""Frame numbers that never wrap, and frame times by this computer's clock."""

from __future__ import annotations

from collections import deque

# The clock offset is the smallest of this many last frames. In their time a camera's clock drifts
# by less than a frame; fewer frames may all have waited in a queue. Chosen by hand.
_REMEMBERED = 100


class FrameStamps:
    """Turns a camera's frame numbers into ones without end, and its times into `time.monotonic`.

    A frame arrives by a delay that varies. The offset of the camera's clock is the smallest
    difference between arrival and stamp over the last frames, so that a frame that waited in a
    queue keeps its time. After `largest_id` the camera begins again at `first_id`.
    """

    def __init__(self, *, largest_id: int | None = None, first_id: int = 0) -> None:
        self._largest = largest_id
        self._first = first_id
        self._rounds = 0
        self._last_id: int | None = None
        self._last_stamp = float("-inf")
        self._offsets: deque[float] = deque(maxlen=_REMEMBERED)

    def count(self, camera_id: int) -> int:
        """The frame's number, one more than that of the frame before it if none was lost."""
        if self._largest is None:
            return camera_id
        # Frames may overtake each other, but none is half a round late.
        wrapped = self._last_id is not None and camera_id < self._last_id - self._largest // 2
        self._rounds += wrapped
        self._last_id = camera_id
        return camera_id + self._rounds * (self._largest - self._first + 1)

    def time(self, stamp: float | None, arrival: float) -> float:
        """When a frame was taken, in `time.monotonic`; never later than it arrived."""
        if stamp is None or stamp <= 0:
            return arrival
        if stamp < self._last_stamp:
            # The camera was restarted, and its clock with it.
            self._offsets.clear()
        self._last_stamp = stamp
        self._offsets.append(arrival - stamp)
        # Rounding may put the sum after the arrival.
        return min(arrival, stamp + min(self._offsets))
