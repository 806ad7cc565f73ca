"""A projector and a camera that look at one scene."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self, TypeVar

from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.live.devices.clock import Clock, SystemClock
from lightmatrix.live.devices.protocols import Camera, Projector
from lightmatrix.simulation.truth import Truth

# Seconds that a camera is waited for which was lost, and between two looks for it.
_PATIENCE = 60.0
_LOOK_EVERY = 1.0
_LOSSES = 2
Result = TypeVar("Result")


class UnfitRigError(DeviceError):
    """Both devices work, but what they show and see cannot be measured with."""


@dataclass(eq=False)
class Rig:
    """A projector and a camera; made by `open_rig`.

    Parameters
    ----------
    projector : Projector
    camera : Camera
    reopen : callable
        Opens the camera again after it was lost; raises a DeviceError while it is not there.
    clock : Clock
        The time that both live by.
    truth : Truth, optional
        Of a virtual rig, the T that it shows, at an exposure of `unit` seconds.
    unit : float
        Seconds.
    patience : float
        Seconds to wait for a frame, beyond its exposure.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:l_objects,real=0") as rig:
    ...     frame = rig.camera.get_image(timeout=1.0)
    >>> frame.data.shape, rig.projector.shape
    ((64, 64), (64, 64))
    """

    projector: Projector
    camera: Camera
    reopen: Callable[[], Camera]
    clock: Clock = field(default_factory=SystemClock)
    truth: Truth | None = None
    unit: float = 1.0
    patience: float = 2.0

    def __repr__(self) -> str:
        return f"Rig({self.projector.info().get('name')}, {self.camera.info().get('name')})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def info(self) -> dict[str, Any]:
        """What both are, JSON-ready."""
        return {"projector": self.projector.info(), "camera": self.camera.info()}

    def close(self) -> None:
        """Give both devices back; may be called twice."""
        try:
            self.camera.close()
        finally:
            self.projector.close()

    def persistently(self, work: Callable[[], Result]) -> Result:
        """Do something, and again from its beginning where the camera was lost meanwhile.

        Raises
        ------
        DeviceError
            If it is lost three times, or not back within a minute.
        """
        for _ in range(_LOSSES):
            try:
                return work()
            except (UnfitRigError, FrameTimeoutError):
                raise
            except DeviceError:
                self.recover()
        return work()

    def recover(self) -> None:
        """Open the camera again after it was lost, once it is back.

        Raises
        ------
        DeviceError
            If it is not back within a minute.
        """
        deadline = self.clock.now() + _PATIENCE
        with suppress(DeviceError):
            self.camera.close()
        while True:
            try:
                self.camera = self.reopen()
                return
            except DeviceError:
                if self.clock.now() > deadline:
                    raise
            self.clock.sleep(_LOOK_EVERY)
