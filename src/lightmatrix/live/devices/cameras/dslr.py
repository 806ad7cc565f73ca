"""Digital cameras on a USB cable, tethered through gphoto2."""

from __future__ import annotations

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

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.files.images import READABLE, read_image
from lightmatrix.live.devices.addresses import Address, Found, missing_extra
from lightmatrix.live.devices.cameras.exposures import (
    check_exposure,
    not_ours_to_set,
    stated_exposure,
)
from lightmatrix.live.devices.protocols import Frame

EXTRA = "dslr"
# What cameras call their exposure time, and where they put a picture.
_SHUTTERS = ("shutterspeed", "shutterspeed2", "exptime")
_TARGET, _MEMORY = "capturetarget", "Internal RAM"
_TIME = re.compile(r"(?:([0-9]+)/)?([0-9]*\.?[0-9]+)s?")


class DSLRCamera:
    """A digital camera; made by `open_dslr`. Each frame is asked for by `trigger`."""

    def __init__(self, gphoto2: Any, camera: Any, name: str, address: Address) -> None:
        self._gphoto2, self._camera = gphoto2, camera
        self._name, self._address = name, address
        # Pictures that were taken and still lie in the camera, with the moment of it.
        self._taken: deque[tuple[Any, float]] = deque()
        self._count = 0
        self._shape: tuple[int, ...] | None = None
        self._bits: int | None = None
        try:
            with self._talking("be set up"):
                self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        settings = self._settings()
        if _TARGET in settings and _MEMORY in settings[_TARGET]:
            self._set(_TARGET, _MEMORY)
        for name, value in self._address.options.items():
            if name == "exposure":
                continue
            if name not in settings:
                raise DeviceError(
                    f"{self._address}: the camera has no setting {name!r}",
                    hint=f"it has {', '.join(sorted(settings))}",
                )
            if settings[name] and value not in settings[name]:
                raise DeviceError(
                    f"{self._address}: {name} cannot be {value!r}",
                    hint=f"it can be {', '.join(settings[name])}",
                )
            self._set(name, value)
        self._shutter = next((name for name in _SHUTTERS if name in settings), None)
        self._speeds: dict[float, str] = {}
        if self._shutter is not None:
            read = {text: _seconds(text) for text in settings[self._shutter]}
            self._speeds = {value: text for text, value in read.items() if value is not None}
        # In its automatic modes it lets nobody choose.
        self._stated = None if self._speeds else stated_exposure(self._address)

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, as the camera is set, or as the address says it."""
        if self._stated is not None:
            return self._stated
        self._check_open()
        with self._talking("say its exposure"):
            text = self._camera.get_single_config(self._shutter).get_value()
        return _seconds(text) or math.nan

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        if self._stated is not None:
            raise not_ours_to_set(self._address)
        self._check_open()
        check_exposure(self._address, seconds, min(self._speeds), max(self._speeds))
        # It has steps; the one that it took is read back.
        nearest = min(self._speeds, key=lambda speed: abs(math.log(speed / seconds)))
        with self._talking("set its exposure"):
            self._set(str(self._shutter), self._speeds[nearest])

    def info(self) -> dict[str, Any]:
        """Name, address, exposures; shape and bits once a frame has been seen, None before."""
        least, most = self._stated, self._stated
        if self._speeds:
            least, most = min(self._speeds), max(self._speeds)
        return {
            "name": self._name,
            "kind": "dslr",
            "address": str(self._address),
            "shape": self._shape,
            "bits": self._bits,
            "trigger": "software",
            "shortest_exposure": least,
            "longest_exposure": most,
        }

    def get_image(self, timeout: float) -> Frame:
        """The next picture, by `trigger` or by the camera's own button, fetched from the camera.

        Its time is when the camera said that it was taken, which is after its exposure.

        Raises
        ------
        FrameTimeoutError
            If none was taken within `timeout` seconds.
        DeviceError
            If the camera is closed or gone, or its pictures cannot be read.
        """
        self._check_open()
        until = time.monotonic() + timeout
        while not self._taken:
            left = until - time.monotonic()
            if left <= 0:
                raise FrameTimeoutError(
                    f"{self._address}: no frame within {timeout:g} s",
                    hint="can it focus? switch the lens to manual focus",
                )
            self._listen(left)
        where, when = self._taken.popleft()
        self._count += 1
        with self._talking("hand over a picture"):
            file = self._camera.file_get(
                where.folder, where.name, self._gphoto2.GP_FILE_TYPE_NORMAL
            )
            content = bytes(memoryview(file.get_data_and_size()))
        return self._frame(where.name, content, when)

    def flush(self) -> None:
        """Pass over pictures that were taken but not yet handed out."""
        self._check_open()
        self._taken.clear()

    def trigger(self) -> None:
        """Take a picture, and wait until it is taken.

        Raises
        ------
        DeviceError
            If the camera does not.
        """
        self._check_open()
        exposure = self.exposure
        began = time.monotonic()
        with self._talking("take a picture"):
            where = self._camera.capture(self._gphoto2.GP_CAPTURE_IMAGE)
        # A driver may come back while the shutter is still open; "bulb" does not say how long.
        left = began + exposure - time.monotonic()
        if left > 0:
            time.sleep(left)
        self._taken.append((where, time.monotonic()))

    def close(self) -> None:
        """Give the camera back."""
        if self._camera is None:
            return
        with suppress(self._gphoto2.GPhoto2Error):
            self._camera.exit()
        self._camera = None

    def _check_open(self) -> None:
        if self._camera is None:
            raise DeviceError(f"{self._address}: is closed", hint="open the camera again")

    def _listen(self, seconds: float) -> None:
        """Wait for a picture that somebody takes at the camera."""
        began = time.monotonic()
        with self._talking("be listened to"):
            kind, what = self._camera.wait_for_event(max(1, int(1000 * seconds)))
        if kind == self._gphoto2.GP_EVENT_FILE_ADDED:
            self._taken.append((what, time.monotonic()))
        # Some drivers come back at once, with nothing.
        elif time.monotonic() - began < 0.01:
            time.sleep(min(0.01, seconds))

    def _frame(self, name: str, content: bytes, when: float) -> Frame:
        suffix = Path(name).suffix.lower()
        if suffix not in READABLE:
            raise DeviceError(
                f"{self._address}: delivers {suffix or 'nameless'} files, which are not read",
                hint="set it to JPEG, or develop them and take the folder with watch:DIR",
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"picture{suffix}"
            path.write_bytes(content)
            try:
                image = read_image(path)
            except InputError as error:
                raise DeviceError(
                    f"{self._address}: {name} came damaged", hint="check the USB cable"
                ) from error
        self._shape, self._bits = image.shape, 8 * image.dtype.itemsize
        return Frame(image, self._count, when, float(np.iinfo(image.dtype).max))

    def _settings(self) -> dict[str, tuple[str, ...]]:
        """What can be set, by name, with the choices that there are."""
        found: dict[str, tuple[str, ...]] = {}
        open_ = [self._camera.get_config()]
        while open_:
            widget = open_.pop()
            open_.extend(widget.get_child(index) for index in range(widget.count_children()))
            if widget.get_type() in (
                self._gphoto2.GP_WIDGET_RADIO,
                self._gphoto2.GP_WIDGET_MENU,
            ):
                choices = (widget.get_choice(index) for index in range(widget.count_choices()))
                found[widget.get_name()] = tuple(choices)
            elif widget.get_type() == self._gphoto2.GP_WIDGET_TEXT:
                found[widget.get_name()] = ()
        return found

    def _set(self, name: str, value: str) -> None:
        widget = self._camera.get_single_config(name)
        widget.set_value(value)
        self._camera.set_single_config(name, widget)

    @contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        with _explained(self._gphoto2, self._address, f"cannot {doing}"):
            yield


def open_dslr(address: Address) -> DSLRCamera:
    """A digital camera that an address names by model or port.

    Parameters
    ----------
    address : Address
        "dslr:Nikon DSC D750", "dslr:usb:001,004", or "dslr" alone for the first that is found.
        Options are the camera's own settings, as gphoto2 calls them: iso=100, imagesize=640x480;
        exposure, in seconds, is for a camera that does not let its shutter be set.

    Raises
    ------
    MissingExtraError
        If gphoto2 is not installed.
    DeviceError
        If there is no such camera, another program has it, or it has no such setting.
    """
    gphoto2 = _load()
    cameras = _autodetect(gphoto2, address)
    wanted = address.argument
    chosen = next((each for each in cameras if not wanted or wanted in each), None)
    if chosen is None:
        listed = ", ".join(f"{name} ({port})" for name, port in cameras) or "none"
        raise DeviceError(
            f"{address}: no such camera was found; there are: {listed}",
            hint="switch it on, set its USB mode to PTP, and unmount it from the file manager",
        )
    name, port = chosen
    camera = gphoto2.Camera()
    with _explained(gphoto2, address, "does not answer"):
        models, ports = gphoto2.CameraAbilitiesList(), gphoto2.PortInfoList()
        models.load()
        ports.load()
        camera.set_abilities(models[models.lookup_model(name)])
        camera.set_port_info(ports[ports.lookup_path(port)])
        camera.init()
    return DSLRCamera(gphoto2, camera, name, address)


def find_dslr() -> list[Found]:
    """The digital cameras on USB.

    Raises
    ------
    MissingExtraError, DeviceError
        As `open_dslr`.
    """
    return [Found(f"dslr:{port}", name) for name, port in _autodetect(_load(), Address("dslr"))]


def _load() -> Any:
    try:
        import gphoto2
    except ImportError as error:
        raise missing_extra(EXTRA, "digital cameras through gphoto2") from error
    return gphoto2


def _autodetect(gphoto2: Any, address: Address) -> list[tuple[str, str]]:
    with _explained(gphoto2, address, "cannot be looked for"):
        cameras = gphoto2.Camera.autodetect()
    return [(cameras.get_name(k), cameras.get_value(k)) for k in range(cameras.count())]


@contextmanager
def _explained(gphoto2: Any, address: Address, what: str) -> Iterator[None]:
    """What gphoto2 says against it becomes ours."""
    try:
        yield
    except gphoto2.GPhoto2Error as error:
        if error.code in (gphoto2.GP_ERROR_IO_USB_CLAIM, gphoto2.GP_ERROR_IO_LOCK):
            raise DeviceError(
                f"{address}: another program has the camera",
                hint="unmount it from the file manager: gio mount -s gphoto2",
            ) from error
        if error.code in (gphoto2.GP_ERROR_NO_MEMORY, gphoto2.GP_ERROR_NO_SPACE):
            raise DeviceError(
                f"{address}: the camera {what}, its memory is full",
                hint=f"empty its card, or let it keep pictures in its memory: {_TARGET}={_MEMORY}",
            ) from error
        raise DeviceError(
            f"{address}: the camera {what} ({error.string})",
            hint="check its cable, battery and focus, and that its USB mode is PTP",
        ) from error


def _seconds(text: str) -> float | None:
    """The exposure time that a camera writes as "1/125", "0.0100s" or "30"; None for "bulb"."""
    found = _TIME.fullmatch(text.strip())
    if found is None or not float(found[2]):
        return None
    return float(found[1] or 1) / float(found[2]) if found[1] else float(found[2])
