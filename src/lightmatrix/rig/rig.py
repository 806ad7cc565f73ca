"""A rig: a projector and a camera that look at one scene, real or virtual."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import PROCEDURAL
from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError, warn
from lightmatrix.patterns.pattern_set import PatternSet, to_grey
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.rig.devices import virtual
from lightmatrix.rig.devices.base import Camera, Clock, Projector
from lightmatrix.rig.devices.registry import open_camera, open_projector
from lightmatrix.simulation import library, realism
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import Truth

Returned = TypeVar("Returned")


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
    """

    projector: Projector
    camera: Camera
    reopen: Callable[[], Camera]
    clock: Clock = field(default_factory=Clock)
    truth: Truth | None = None
    unit: float = 1.0

    def __repr__(self) -> str:
        return f"Rig({self.projector.info().get('name')}, {self.camera.info().get('name')})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give both devices back; may be called twice."""
        try:
            self.camera.close()
        finally:
            self.projector.close()

    def persistently(self, work: Callable[[], Returned]) -> Returned:
        """Do some work, and begin it anew if the camera was lost meanwhile, up to twice."""
        for _ in range(2):
            try:
                return work()
            except (UnfitRigError, FrameTimeoutError):
                raise
            except DeviceError:
                self.recover()
        return work()

    def recover(self) -> None:
        """Open a lost camera again, once it is back; it is looked for every second of a minute."""
        deadline = self.clock.now() + 60
        with suppress(DeviceError):
            self.camera.close()
        while True:
            try:
                self.camera = self.reopen()
                return
            except DeviceError:
                if self.clock.now() > deadline:
                    raise
            self.clock.sleep(1)


def open_rig(
    rig: str | virtual.VirtualSettings | None = None,
    *,
    projector: str | Sequence[str] | None = None,
    camera: str | None = None,
) -> Rig:
    """Open a projector and a camera, or a virtual rig.

    Parameters
    ----------
    rig : str or VirtualSettings, optional
        ``virtual:SCENE``, or ``virtual:SCENE,name=value,...``; see `VirtualSettings`.
    projector, camera : str, optional
        Instead: addresses of devices, such as ``window:1`` and ``aravis:ID``. Several projectors
        become one, whose picture holds those of all, one above the other.

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
    >>> lm.open_rig("virtual:metal,delay=3,real=0")
    Rig(virtual:metal, virtual:metal)
    """
    if rig is None:
        if not projector or camera is None:
            raise InputError(
                "there is no rig to photograph with",
                hint="give a rig, virtual:l_objects, or a projector and a camera; "
                "`lightmatrix rig list` names those that are there",
            )
        # The camera comes first: if another program has it, no window flashes up.
        first = open_camera(camera)
        try:
            return Rig(open_projector(projector), first, lambda: open_camera(camera))
        except BaseException:
            first.close()
            raise
    elif projector or camera is not None:
        hint = "a virtual rig has both; give one or the other"
        raise InputError("a rig and a projector or a camera", hint=hint)
    settings = rig if isinstance(rig, virtual.VirtualSettings) else virtual.parse_settings(rig)
    size = (settings.size, settings.size)
    if settings.scene == PROCEDURAL:
        truth = ProceduralScene(size, size, settings.seed).truth()
    else:
        truth = library.truth(settings.scene, size, camera=settings.camera)
    clock = virtual.SimulatedClock() if not settings.real else Clock()
    light = virtual.VirtualLight(truth, realism.ambient(truth, settings.room), settings)
    device = virtual.VirtualCamera(light, clock)
    # The light of a black pixel is in the black frame, so the T that can be measured is smaller.
    measurable = truth.scaled(np.float32(1 - virtual.HARDWARE.leak))
    lamp = virtual.VirtualProjector(light, clock)
    return Rig(lamp, device, device.reopen, clock, measurable, settings.unit)


@dataclass(frozen=True, eq=False)
class ProjectedPatterns:
    """A pattern set on a projector's screen; an InputError if it does not fit."""

    # K patterns.
    patterns: PatternSet
    # (rows, cols): the projector's pixels.
    screen: tuple[int, int]
    # Projector pixels along a side of each pattern pixel.
    cell: int = 1
    # Chooses grey values that give the patterns' light; black-and-white patterns need none.
    response: ProjectorResponse | None = None

    def __post_init__(self) -> None:
        rows, cols = self.patterns.shape
        if rows * self.cell > self.screen[0] or cols * self.cell > self.screen[1]:
            cells = f", each pixel {self.cell} x {self.cell}" if self.cell > 1 else ""
            raise InputError(
                f"patterns of {rows} x {cols} pixels{cells}, for a projector of "
                f"{self.screen[0]} x {self.screen[1]}",
                hint=f"make patterns of {self.screen[0] // self.cell}x"
                f"{self.screen[1] // self.cell} at most",
            )
        if rows > cols and self.screen[0] < self.screen[1]:
            warn(
                f"the patterns are portrait, {rows} rows by {cols} columns, and the projector is "
                f"landscape, {self.screen[0]} by {self.screen[1]}: rows come first in all sizes"
            )

    @cached_property
    def _grey(self) -> bool:
        return self.patterns.as_bits() is None

    def image(self, index: int) -> NDArray[np.uint8]:
        """The image of a pattern, (rows, cols) uint8, in the middle of a black screen."""
        light = self.patterns.images(index, index + 1)[0]
        if self._grey and self.response is not None:
            grey = self.response.grey_for(light)
        else:
            grey = to_grey(light)
        return on_screen(grey, self.screen, self.cell)


def on_screen(grey: NDArray[np.uint8], screen: tuple[int, int], cell: int) -> NDArray[np.uint8]:
    """An image (rows, cols[, 3]), each pixel `cell` x `cell`, in the middle of a black screen."""
    wide = grey.repeat(cell, axis=0).repeat(cell, axis=1)
    whole = np.zeros((*screen, *wide.shape[2:]), np.uint8)
    top, left = ((a - b) // 2 for a, b in zip(screen, wide.shape, strict=False))
    whole[top : top + wide.shape[0], left : left + wide.shape[1]] = wide
    return whole
