"""A rig: a projector and a camera that look at one scene, real or virtual."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeVar

import numpy as np

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.clock import Clock, SimulatedClock, SystemClock
from lightmatrix.live.devices.protocols import Camera, Projector
from lightmatrix.live.devices.registry import open_camera, open_projector
from lightmatrix.live.devices.virtual.camera import VirtualCamera
from lightmatrix.live.devices.virtual.light import Light
from lightmatrix.live.devices.virtual.projector import VirtualProjector
from lightmatrix.live.devices.virtual.settings import PROCEDURAL, VirtualSettings, parse_settings
from lightmatrix.ranges import check_number
from lightmatrix.simulation import library, realism
from lightmatrix.simulation.procedural_scene import ProceduralScene
from lightmatrix.simulation.truth import Truth

# Seconds to wait for a frame beyond its exposure.
USUAL_PATIENCE = 2.0
# A lost camera is looked for every second, for a minute: long enough to plug it in again.
_SEARCH, _SEARCH_EVERY = 60.0, 1.0
# Work that is begun anew after a loss of the camera is given up at the third loss.
_MOST_LOSSES = 2
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
        The clock of both devices.
    truth : Truth, optional
        The T that a virtual rig shows, at an exposure of `unit` seconds.
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
    patience: float = USUAL_PATIENCE

    def __repr__(self) -> str:
        return f"Rig({self.projector.info().get('name')}, {self.camera.info().get('name')})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def info(self) -> dict[str, Any]:
        """JSON-ready facts about both devices."""
        return {"projector": self.projector.info(), "camera": self.camera.info()}

    def close(self) -> None:
        """Give both devices back; may be called twice."""
        try:
            self.camera.close()
        finally:
            self.projector.close()

    def persistently(self, work: Callable[[], Result]) -> Result:
        """Do some work, and begin it anew if the camera was lost meanwhile.

        Raises
        ------
        DeviceError
            If the camera is lost three times, or not back within a minute.
        """
        for _ in range(_MOST_LOSSES):
            try:
                return work()
            except (UnfitRigError, FrameTimeoutError):
                raise
            except DeviceError:
                self.recover()
        return work()

    def recover(self) -> None:
        """Open a lost camera again, once it is back.

        Raises
        ------
        DeviceError
            If it is not back within a minute.
        """
        deadline = self.clock.now() + _SEARCH
        with suppress(DeviceError):
            self.camera.close()
        while True:
            try:
                self.camera = self.reopen()
                return
            except DeviceError:
                if self.clock.now() > deadline:
                    raise
            self.clock.sleep(_SEARCH_EVERY)


def open_rig(
    rig: str | VirtualSettings | None = None,
    *,
    projector: str | None = None,
    camera: str | None = None,
    patience: float = USUAL_PATIENCE,
) -> Rig:
    """Open a projector and a camera, or a virtual rig.

    Parameters
    ----------
    rig : str or VirtualSettings, optional
        ``virtual:SCENE``, or ``virtual:SCENE,name=value,...``; see `VirtualSettings`.
    projector, camera : str, optional
        Instead: addresses of devices, such as ``window:1`` and ``aravis:ID``.
    patience : float
        Seconds to wait for a frame, beyond its exposure; cameras that store or send frames slowly
        need more.

    Returns
    -------
    Rig
        Close it in the end, best by a ``with`` statement.

    Raises
    ------
    InputError
        If an address makes no sense, or there is one device without the other.
    DeviceError
        If a device is missing or in use.
    MissingExtraError
        If the packages of a device's back end are not installed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.open_rig("virtual:metal,delay=3,late=0.05,real=0")
    Rig(virtual:metal, virtual:metal)
    """
    check_number("a patience", patience, most=3600, above=True, hint="give seconds, such as 10")
    if rig is None:
        if projector is None or camera is None:
            raise InputError(
                "there is no rig to photograph with",
                hint="give --rig virtual:l_objects, or --projector and --camera; "
                "`lightmatrix rig list` names those that are there",
            )
        opened = _real(projector, camera)
    elif projector is not None or camera is not None:
        raise InputError(
            "a rig and a projector or a camera",
            hint="a virtual rig has both; give one or the other",
        )
    else:
        opened = _virtual(rig if isinstance(rig, VirtualSettings) else parse_settings(rig))
    opened.patience = patience
    return opened


def _real(projector: str, camera: str) -> Rig:
    # The camera comes first: if another program has it, no window flashes up.
    opened = open_camera(camera)
    try:
        return Rig(open_projector(projector), opened, lambda: open_camera(camera))
    except BaseException:
        opened.close()
        raise


def _virtual(settings: VirtualSettings) -> Rig:
    truth = realism.defocus(_scene(settings), settings.blur)
    room = realism.ambient(truth, settings.room)
    clock = SystemClock() if settings.real else SimulatedClock()
    light = Light(truth, room, settings, clock.now())
    camera = VirtualCamera(light, settings, clock)
    # The light of a black pixel is in the black frame, so the T that can be measured is smaller.
    contrast = np.float32(1 - settings.leak)
    measurable = replace(
        truth,
        matrix=truth.with_data(contrast * truth.matrix.data),
        direct_data=contrast * truth.direct_data,
    )
    projector = VirtualProjector(light, settings, clock)
    return Rig(projector, camera, camera.reopen, clock, measurable, settings.unit)


def _scene(settings: VirtualSettings) -> Truth:
    size = (settings.size, settings.size)
    if settings.scene == PROCEDURAL:
        return ProceduralScene(size, size, settings.seed).truth()
    return library.truth(settings.scene, size)
