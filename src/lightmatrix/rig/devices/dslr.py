"""Digital cameras on a USB cable, tethered through gphoto2."""

import math
import re
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import READABLE, read_image
from lightmatrix.rig.devices.base import Address, AvailableDevice, Camera, Frame, load

# The setting that chooses where pictures are stored, and its value for the camera's own memory.
_TARGET, _MEMORY = "capturetarget", "Internal RAM"


class DSLRCamera(Camera):
    """A digital camera; made by `open_dslr`. Each frame is asked for by `trigger`."""

    kind = "dslr"
    # It stores a frame before it sends it.
    patience = 30.0

    def __init__(self, gphoto2: Any, camera: Any, name: str, address: Address) -> None:
        super().__init__(address)
        self._gphoto2, self._camera, self._name = gphoto2, camera, name
        self._trigger = "software"
        # Pictures that still lie in the camera, each with the time at which it was taken.
        self._waiting: deque[tuple[Any, float]] = deque()
        with self._opening(), self._talking("be set up"):
            self._set_up()

    def _set_up(self) -> None:
        settings = self._settings()
        if _TARGET in settings and _MEMORY in settings[_TARGET]:
            self._set(_TARGET, _MEMORY)
        for name, value in self._address.options.items():
            if name == "exposure":
                continue
            if name not in settings:
                raise self._error(
                    f"the camera has no setting {name!r}", f"it has {', '.join(sorted(settings))}"
                )
            if settings[name] and value not in settings[name]:
                raise self._error(
                    f"{name} cannot be {value!r}", f"it can be {', '.join(settings[name])}"
                )
            self._set(name, value)
        # Makers have different names for the exposure time.
        names = ("shutterspeed", "shutterspeed2", "exptime")
        self._shutter = next((name for name in names if name in settings), None)
        self._speeds: dict[float, str] = {}
        if self._shutter is not None:
            read = {text: _seconds(text) for text in settings[self._shutter]}
            self._speeds = {value: text for text, value in read.items() if value is not None}
        if not self._speeds:
            # In its automatic modes the camera does not let the exposure be set.
            self._stated = self._address.stated_exposure

    def get_image(self, timeout: float) -> Frame:
        """The next picture, timed when the camera reported it, which is after its exposure."""
        self._check_open()
        if not self._waiting:
            # A picture is there when `trigger` returns, or never comes.
            time.sleep(timeout)
            raise self._timeout(timeout, "can it focus? switch the lens to manual focus")
        where, when = self._waiting.popleft()
        with self._talking("hand over a picture"):
            file = self._camera.file_get(
                where.folder, where.name, self._gphoto2.GP_FILE_TYPE_NORMAL
            )
            content = bytes(memoryview(file.get_data_and_size()))
        return self._frame(where.name, content, when)

    def flush(self) -> None:
        """Pass over pictures that were taken but not yet handed out."""
        self._check_open()
        self._waiting.clear()

    def trigger(self) -> None:
        """Take a picture, and wait until it is taken."""
        self._check_open()
        exposure = self.exposure
        began = time.monotonic()
        with self._talking("take a picture"):
            where = self._camera.capture(self._gphoto2.GP_CAPTURE_IMAGE)
        # A driver may return while the shutter is still open; "bulb" does not say how long.
        left = began + exposure - time.monotonic()
        if left > 0:
            time.sleep(left)
        self._waiting.append((where, time.monotonic()))

    def _give_back(self) -> None:
        with suppress(self._gphoto2.GPhoto2Error):
            self._camera.exit()
        self._camera = None

    def _exposure_range(self) -> tuple[float, float]:
        return min(self._speeds), max(self._speeds)

    def _read_exposure(self) -> float:
        self._check_open()
        with self._talking("say its exposure"):
            text = self._camera.get_single_config(self._shutter).get_value()
        return _seconds(text) or math.nan

    def _write_exposure(self, seconds: float) -> None:
        # A shutter has steps; the one that was set is read back.
        nearest = min(self._speeds, key=lambda speed: abs(math.log(speed / seconds)))
        with self._talking("set its exposure"):
            self._set(str(self._shutter), self._speeds[nearest])

    def _frame(self, name: str, content: bytes, when: float) -> Frame:
        suffix = Path(name).suffix.lower()
        if suffix not in READABLE:
            raise self._error(
                f"delivers {suffix or 'nameless'} files, which are not read",
                "set it to JPEG, or develop them and take the folder with watch:DIR",
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"picture{suffix}"
            path.write_bytes(content)
            try:
                image = read_image(path)
            except InputError as error:
                raise self._error(f"{name} came damaged", "check the USB cable") from error
        self._shape, self._bits = image.shape, 8 * image.dtype.itemsize
        return Frame(image, when, float(np.iinfo(image.dtype).max))

    def _settings(self) -> dict[str, tuple[str, ...]]:
        """Settings by name with their choices; none for a free text."""
        gphoto2 = self._gphoto2
        settings: dict[str, tuple[str, ...]] = {}
        widgets = [self._camera.get_config()]
        while widgets:
            widget = widgets.pop()
            widgets.extend(widget.get_child(index) for index in range(widget.count_children()))
            if widget.get_type() in (gphoto2.GP_WIDGET_RADIO, gphoto2.GP_WIDGET_MENU):
                choices = (widget.get_choice(index) for index in range(widget.count_choices()))
                settings[widget.get_name()] = tuple(choices)
            elif widget.get_type() == gphoto2.GP_WIDGET_TEXT:
                settings[widget.get_name()] = ()
        return settings

    def _set(self, name: str, value: str) -> None:
        widget = self._camera.get_single_config(name)
        widget.set_value(value)
        self._camera.set_single_config(name, widget)

    @contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        with _translated_errors(self._gphoto2, self._address, f"cannot {doing}"):
            yield


def open_dslr(address: Address) -> DSLRCamera:
    """Open a digital camera by its model or port, or the first one.

    Addresses are "dslr:Nikon DSC D750" or "dslr:usb:001,004". Options are the camera's own
    settings, as gphoto2 calls them: iso=100, imagesize=640x480. The option exposure, in seconds, is
    for a camera that does not let its shutter be set.
    """
    gphoto2 = _load()
    cameras = _detected(gphoto2, address)
    wanted = address.argument
    chosen = next((each for each in cameras if not wanted or wanted in each), None)
    if chosen is None:
        listed = ", ".join(f"{name} ({port})" for name, port in cameras) or "none"
        hint = "switch it on, set its USB mode to PTP, and unmount it from the file manager"
        raise DeviceError(f"{address}: no such camera was found; there are: {listed}", hint=hint)
    name, port = chosen
    camera = gphoto2.Camera()
    with _translated_errors(gphoto2, address, "does not answer"):
        models, ports = gphoto2.CameraAbilitiesList(), gphoto2.PortInfoList()
        models.load()
        ports.load()
        camera.set_abilities(models[models.lookup_model(name)])
        camera.set_port_info(ports[ports.lookup_path(port)])
        camera.init()
    return DSLRCamera(gphoto2, camera, name, address)


def find_dslr() -> list[AvailableDevice]:
    """The digital cameras on USB."""
    cameras = _detected(_load(), Address("dslr"))
    return [AvailableDevice(f"dslr:{port}", name) for name, port in cameras]


def _load() -> Any:
    return load("dslr", "digital cameras through gphoto2", "gphoto2")[0]


def _detected(gphoto2: Any, address: Address) -> list[tuple[str, str]]:
    with _translated_errors(gphoto2, address, "cannot be looked for"):
        cameras = gphoto2.Camera.autodetect()
    return [(cameras.get_name(k), cameras.get_value(k)) for k in range(cameras.count())]


@contextmanager
def _translated_errors(gphoto2: Any, address: Address, what: str) -> Iterator[None]:
    """Turn errors of gphoto2 into a DeviceError that says what to do."""
    try:
        yield
    except gphoto2.GPhoto2Error as error:
        if error.code in (gphoto2.GP_ERROR_IO_USB_CLAIM, gphoto2.GP_ERROR_IO_LOCK):
            hint = "unmount it from the file manager: gio mount -s gphoto2"
            raise DeviceError(f"{address}: another program has the camera", hint=hint) from error
        hint = "check its cable, battery and focus, and that its USB mode is PTP"
        raise DeviceError(f"{address}: the camera {what} ({error.string})", hint=hint) from error


def _seconds(text: str) -> float | None:
    """An exposure time that a camera writes as "1/125", "0.0100s" or "30"; None for "bulb"."""
    match = re.fullmatch(r"(?:([0-9]+)/)?([0-9]*\.?[0-9]+)s?", text.strip())
    if match is None or not float(match[2]):
        return None
    return float(match[1] or 1) / float(match[2]) if match[1] else float(match[2])
