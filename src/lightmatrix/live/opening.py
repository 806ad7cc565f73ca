"""Rigs by their names, as the command line has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.live.devices.clock import SimulatedClock, SystemClock
from lightmatrix.live.devices.registry import open_camera, open_projector
from lightmatrix.live.devices.virtual.camera import VirtualCamera
from lightmatrix.live.devices.virtual.light import Light
from lightmatrix.live.devices.virtual.projector import VirtualProjector
from lightmatrix.live.devices.virtual.settings import PROCEDURAL, VirtualSettings, parse_settings
from lightmatrix.live.rig import Rig
from lightmatrix.ranges import check_number
from lightmatrix.simulation import library, realism
from lightmatrix.simulation.procedural_scene import ProceduralScene
from lightmatrix.simulation.truth import Truth

USUAL_PATIENCE = 2.0


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
        Instead: names of devices, such as ``window:1`` and ``aravis:ID``.
    patience : float
        Seconds to wait for a frame, beyond its exposure; cameras that store or send frames slowly
        need more.

    Returns
    -------
    Rig
        To be closed, best by a ``with`` statement.

    Raises
    ------
    InputError
        On names that are none, or one device without the other.
    DeviceError
        If a device is missing or in use.
    MissingExtraError
        If what drives it is not installed.

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
    # The camera first: it is the one that others may have, and then no window need flash up.
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
    # What a black pixel leaks is in the black frame, as the room's light is.
    contrast = np.float32(1 - settings.leak)
    shown = replace(
        truth,
        matrix=truth.with_data(contrast * truth.matrix.data),
        direct_data=contrast * truth.direct_data,
    )
    projector = VirtualProjector(light, settings, clock)
    return Rig(projector, camera, camera.reopen, clock, shown, settings.unit)


def _scene(settings: VirtualSettings) -> Truth:
    size = (settings.size, settings.size)
    if settings.scene == PROCEDURAL:
        return ProceduralScene(size, size, settings.seed).truth()
    return library.truth(settings.scene, size)
