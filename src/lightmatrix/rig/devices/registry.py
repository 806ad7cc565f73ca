"""The back ends that lightmatrix has, and opening devices by their addresses."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from lightmatrix.errors import DeviceError, InputError, MissingExtraError
from lightmatrix.rig.devices.aravis import find_aravis, open_aravis
from lightmatrix.rig.devices.base import Address, AvailableDevice, Camera, Projector
from lightmatrix.rig.devices.dslr import find_dslr, open_dslr
from lightmatrix.rig.devices.folders import open_folder, open_watched
from lightmatrix.rig.devices.gentl import find_gentl, open_gentl
from lightmatrix.rig.devices.several import SeveralProjectors
from lightmatrix.rig.devices.video import find_video, open_video
from lightmatrix.rig.devices.window import find_windows, open_window

Device = TypeVar("Device")


@dataclass(frozen=True)
class BackEnd(Generic[Device]):
    """A kind of device: what it is, how to open one, and what of it is there."""

    # One of "projector", "camera".
    role: str
    # Its name, what it is, and the form of its addresses.
    kind: str
    summary: str
    form: str
    open: Callable[[Address], Device]
    # Lists the devices that are present; None where they cannot be listed.
    find: Callable[[], list[AvailableDevice]] | None = None
    found: tuple[AvailableDevice, ...] = ()
    # Why it cannot be used now, and what to do.
    problem: str | None = None
    hint: str | None = None


PROJECTORS: dict[str, BackEnd[Projector]] = {
    kind: BackEnd("projector", kind, *each)
    for kind, each in {
        "window": ("full-screen window on a monitor", "window:MONITOR", open_window, find_windows),
        "folder": (
            "file that another program shows", "folder:DIR,size=ROWSxCOLUMNS", open_folder, None,
        ),
    }.items()
}  # fmt: skip
CAMERAS: dict[str, BackEnd[Camera]] = {
    kind: BackEnd("camera", kind, *each)
    for kind, each in {
        "aravis": ("GigE and USB3 Vision", "aravis:ID", open_aravis, find_aravis),
        "gentl": ("any maker's, by its GenTL producer", "gentl:ID", open_gentl, find_gentl),
        "video": (
            "web cameras and frame grabbers", "video:DEVICE,exposure=SECONDS", open_video,
            find_video,
        ),
        "dslr": ("digital cameras, tethered", "dslr:MODEL", open_dslr, find_dslr),
        "watch": (
            "files from whatever takes them", "watch:DIR,exposure=SECONDS", open_watched, None,
        ),
    }.items()
}  # fmt: skip


def open_projector(address: str | Sequence[str]) -> Projector:
    """Open a projector by its address; close it in the end.

    The address is KIND, KIND:ARGUMENT or KIND:ARGUMENT,option=value, as in ``window:1``. Several
    projectors become one, whose picture holds those of all, one above the other.

    Raises
    ------
    InputError
        If the kind or an option is unknown.
    MissingExtraError
        If the packages of its back end are not installed.
    DeviceError
        If there is no such device, or it is in use.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> projector = lm.open_projector("folder:shown,size=48x64")
    >>> projector.shape
    (48, 64)
    >>> projector.close()
    """
    several = [address] if isinstance(address, str) else address
    if not several:
        raise InputError("no projector", hint="give an address such as window:1")
    with ExitStack() as opened:
        opening = (_open_device(PROJECTORS, "projector", one) for one in several)
        each = [opened.enter_context(closing(one)) for one in opening]
        opened.pop_all()
    return each[0] if len(each) == 1 else SeveralProjectors(each)


def open_camera(address: str) -> Camera:
    """Open a camera by its address, such as ``aravis:Basler-21,trigger=free,Gain=0``.

    Addresses and errors are as in `open_projector`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> camera = lm.open_camera("watch:.,exposure=0.02")
    >>> camera.exposure
    0.02
    >>> camera.close()
    """
    return _open_device(CAMERAS, "camera", address)


def list_devices() -> list[BackEnd[Any]]:
    """List every back end with the devices that it finds, or with what it lacks.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> [back.kind for back in lm.list_devices() if back.role == "projector"]
    ['window', 'folder']
    """
    known: list[BackEnd[Any]] = [*PROJECTORS.values(), *CAMERAS.values()]
    for number, back in enumerate(known):
        try:
            known[number] = replace(back, found=tuple(back.find() if back.find else ()))
        except (MissingExtraError, DeviceError) as error:
            known[number] = replace(back, problem=error.message, hint=error.hint)
    return known


def _open_device(known: Mapping[str, BackEnd[Device]], role: str, text: str) -> Device:
    address = Address.parse(text)
    if address.kind not in known:
        forms = ", ".join(back.form for back in known.values())
        raise InputError(f"{text}: no such {role}", hint=f"a {role} is one of {forms}")
    return known[address.kind].open(address)
