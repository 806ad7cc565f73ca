"""Frame numbers and times of a camera, in our own clock."""

from __future__ import annotations

from collections import deque

# So many frames are looked back on; in their time a camera's clock drifts by less than a frame.
_REMEMBERED = 100


class Stamps:
    """Turns a camera's frame numbers into ones without end, and its times into `time.monotonic`.

    A frame arrives at the host some time after its exposure, by a delay that varies; the camera
    stamps it with a clock of its own, whose offset is unknown. The frame that travelled fastest
    tells the offset best: the smallest difference between arrival and stamp over the last frames.
    So a frame that lay in a queue keeps the time at which it was taken.

    Parameters
    ----------
    largest_id : int, optional
        The number after which the camera begins again at `first_id`.
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
        if self._largest is not None:
            # A later frame may arrive first, but none is half a round late.
            back = self._last_id is not None and camera_id < self._last_id - self._largest // 2
            self._rounds += back
            self._last_id = camera_id
            return camera_id + self._rounds * (self._largest - self._first + 1)
        return camera_id

    def time(self, stamp: float | None, arrival: float) -> float:
        """When a frame was taken, in seconds of `time.monotonic`; never later than it arrived.

        Parameters
        ----------
        stamp : float or None
            Seconds by the camera's clock; None if it has none.
        arrival : float
            When the host heard of it.
        """
        if stamp is None or stamp <= 0:
            return arrival
        if stamp < self._last_stamp:
            # The camera was restarted, and its clock with it.
            self._offsets.clear()
        self._last_stamp = stamp
        self._offsets.append(arrival - stamp)
        # The sum is rounded.
        return min(arrival, stamp + min(self._offsets))
