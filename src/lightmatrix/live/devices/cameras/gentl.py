"""Cameras of any maker through the GenTL producer that comes with them, by harvesters."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.live.devices.addresses import Address, Found, missing_extra
from lightmatrix.live.devices.cameras.exposures import (
    check_exposure,
    not_ours_to_set,
    stated_exposure,
)
from lightmatrix.live.devices.cameras.formats import PixelFormat, choose_format
from lightmatrix.live.devices.cameras.stamps import Stamps
from lightmatrix.live.devices.protocols import Frame

EXTRA = "gentl"
# Folders of producers, as the standard has it.
_PATHS = "GENICAM_GENTL64_PATH"
_BUFFERS = 8
# What switches off, where a camera has it, all that alters pictures by itself.
_PLAIN = ("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto")
# Frames that are thrown away wait already; none is waited for.
_AT_ONCE = 0.001


class GenTLCamera:
    """A camera behind a GenTL producer; made by `open_gentl`."""

    def __init__(self, gentl: Any, harvester: Any, address: Address) -> None:
        self._gentl, self._harvester, self._address = gentl, harvester, address
        self._acquirer: Any = None
        self._stamps = Stamps()
        try:
            device = _chosen(harvester, address)
            self._name = f"{device.vendor} {device.model} {device.serial_number}"
            with self._talking("be set up"):
                self._acquirer = harvester.create(harvester.device_info_list.index(device))
                self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        for name in _PLAIN:
            if (node := self._node(name)) is not None:
                # Some cameras have it without an Off.
                with suppress(self._gentl.GenericException):
                    node.value = "Off"
        self._set_features()
        self._format = self._set_format()
        self._trigger = self._set_trigger()
        nodes = self._acquirer.remote_device.node_map
        self._size = (int(nodes.Height.value), int(nodes.Width.value))
        self._exposure = self._node("ExposureTime") or self._node("ExposureTimeAbs")
        # A camera that does not say it needs a user who does.
        self._stated = None if self._exposure is not None else stated_exposure(self._address)
        self._acquirer.num_buffers = max(_BUFFERS, self._acquirer.min_num_buffers)
        self._acquirer.start()

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, read back from the camera, or as the address says it."""
        if self._stated is not None:
            return self._stated
        with self._talking("say its exposure"):
            return float(self._exposure.value) * 1e-6

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        if self._stated is not None:
            raise not_ours_to_set(self._address)
        with self._talking("set its exposure"):
            check_exposure(self._address, seconds, *self._exposures())
            self._exposure.value = seconds * 1e6

    def info(self) -> dict[str, Any]:
        """Name, address, shape, pixel format, bits, trigger."""
        channels = () if self._format.channels == 1 else (self._format.channels,)
        least, most = self._exposures()
        return {
            "name": self._name,
            "kind": "gentl",
            "address": str(self._address),
            "shape": (*self._size, *channels),
            "bits": self._format.bits,
            "pixel_format": self._format.name,
            "trigger": self._trigger,
            "shortest_exposure": least,
            "longest_exposure": most,
        }

    def get_image(self, timeout: float) -> Frame:
        """The next frame that came whole.

        Raises
        ------
        FrameTimeoutError
            If none came in `timeout` seconds.
        DeviceError
            If the camera is closed or gone.
        """
        self._check_open()
        try:
            # Those of which a part was lost are passed over by harvesters.
            with (
                self._talking("deliver frames"),
                self._acquirer.fetch(timeout=max(_AT_ONCE, timeout)) as buffer,
            ):
                return self._frame(buffer)
        except self._gentl.TimeoutException:
            raise self._no_frame(timeout) from None

    def flush(self) -> None:
        """Throw away frames that arrived but were not yet handed out."""
        self._check_open()
        # As many as there is room for: a camera that runs freely goes on meanwhile.
        for _ in range(self._acquirer.num_buffers):
            try:
                with self._talking("be flushed"), self._acquirer.fetch(timeout=_AT_ONCE):
                    pass
            except self._gentl.TimeoutException:
                return

    def trigger(self) -> None:
        """Ask for one frame; nothing unless the camera was opened with trigger=software."""
        self._check_open()
        if self._trigger == "software":
            with self._talking("be triggered"):
                self._acquirer.remote_device.node_map.TriggerSoftware.execute()

    def close(self) -> None:
        """Stop the camera and give it back."""
        if self._harvester is None:
            return
        with suppress(self._gentl.GenericException):
            if self._acquirer is not None:
                self._acquirer.destroy()
        self._harvester.reset()
        self._acquirer = self._harvester = None

    def _check_open(self) -> None:
        if self._acquirer is None:
            raise DeviceError(f"{self._address}: is closed", hint="open the camera again")

    def _node(self, name: str) -> Any:
        return getattr(self._acquirer.remote_device.node_map, name, None)

    def _exposures(self) -> tuple[float, float]:
        if self._stated is not None:
            return self._stated, self._stated
        return float(self._exposure.min) * 1e-6, float(self._exposure.max) * 1e-6

    def _frame(self, buffer: Any) -> Frame:
        arrival = time.monotonic()
        stamp = None
        # Some producers do not date their frames.
        with suppress(self._gentl.GenericException):
            stamp = buffer.module.timestamp_ns * 1e-9
        image = buffer.payload.components[0]
        # The buffer is used again for another frame.
        data = self._format.image(image.data.tobytes(), image.height, image.width)
        taken = self._stamps.time(stamp, arrival)
        return Frame(data, int(buffer.module.frame_id), taken, self._format.clip_level)

    def _no_frame(self, timeout: float) -> FrameTimeoutError:
        hint = "is the cable of the trigger connected? trigger=software or trigger=free need none"
        if self._trigger in ("free", "software"):
            hint = "does its maker's program get pictures? try a smaller one: Width, Height"
        return FrameTimeoutError(f"{self._address}: no frame within {timeout:g} s", hint=hint)

    def _set_features(self) -> None:
        for name, value in self._address.options.items():
            if not name[0].isupper() or name == "PixelFormat":
                continue
            node = self._node(name)
            if node is None:
                raise DeviceError(
                    f"{self._address}: the camera has no feature {name}",
                    hint="its maker's program lists those that it has",
                )
            try:
                node.from_string(value)
            except (self._gentl.GenericException, Exception) as error:
                raise DeviceError(
                    f"{self._address}: {name}={value} was refused ({_text(error)})",
                    hint="its maker's program says what its features can be",
                ) from error

    def _set_format(self) -> PixelFormat:
        node = self._node("PixelFormat")
        chosen = choose_format(
            str(self._address), tuple(node.symbolics), self._address.options.get("PixelFormat")
        )
        node.value = chosen.name
        return chosen

    def _set_trigger(self) -> str:
        can = self._node("TriggerSoftware") is not None
        wanted = self._address.options.get("trigger", "software" if can else "free")
        mode, selector = self._node("TriggerMode"), self._node("TriggerSelector")
        if selector is not None and "FrameStart" in selector.symbolics:
            selector.value = "FrameStart"
        if wanted == "free":
            if mode is not None:
                mode.value = "Off"
            return wanted
        node = self._node("TriggerSource")
        sources = () if node is None else tuple(node.symbolics)
        source = "Software" if wanted == "software" else wanted
        if source not in sources or mode is None:
            raise DeviceError(
                f"{self._address}: the camera has no trigger {wanted!r}",
                hint=f"its triggers are {', '.join(sources) or 'none'}, and free",
            )
        node.value = source
        mode.value = "On"
        return wanted

    @contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        """What the producer says against it becomes ours, but for frames that are late."""
        try:
            yield
        except self._gentl.TimeoutException:
            raise
        except self._gentl.ResourceInUseException as error:
            raise DeviceError(
                f"{self._address}: another program has the camera", hint="close it there"
            ) from error
        except self._gentl.GenericException as error:
            raise DeviceError(
                f"{self._address}: the camera cannot {doing} ({_text(error)})",
                hint="check its cable and power, and whether another program has it",
            ) from error


def open_gentl(address: Address) -> GenTLCamera:
    """A camera that an address names by id, serial number, or number in the list.

    Parameters
    ----------
    address : Address
        "gentl:ID", or "gentl" alone for the first one. Option producer is the maker's .cti file
        (otherwise all those in the folders of GENICAM_GENTL64_PATH); trigger is software, free or
        an input, as Line1; exposure, in seconds, is for a camera that does not say it; options
        with a capital are its own features: Gain=0, Width=640.

    Raises
    ------
    MissingExtraError
        If harvesters is not installed.
    DeviceError
        If there is no producer or no such camera, another program has it, or it refuses a setting.
    """
    address.check_options(("producer", "trigger", "exposure"), features=True)
    gentl, harvester = _harvester(address)
    return GenTLCamera(gentl, harvester, address)


def find_gentl() -> list[Found]:
    """The cameras that the installed producers find.

    Raises
    ------
    MissingExtraError, DeviceError
        As `open_gentl`.
    """
    _, harvester = _harvester(Address("gentl"))
    found = []
    for device in harvester.device_info_list:
        words = f"{device.vendor} {device.model}, serial number {device.serial_number}"
        found.append(Found(f"gentl:{device.id_}", words))
    harvester.reset()
    return found


def _harvester(address: Address) -> tuple[Any, Any]:
    try:
        from genicam import gentl
        from harvesters.core import Harvester
    except ImportError as error:
        raise missing_extra(EXTRA, "cameras through GenTL") from error
    producers = _producers(address)
    # It prints what it raises as well.
    logging.getLogger("harvesters").setLevel(logging.CRITICAL)
    harvester = Harvester()
    try:
        for producer in producers:
            harvester.add_file(str(producer), check_validity=True)
        harvester.update()
    # A producer is code of its maker's, and so are its errors.
    except Exception as error:
        harvester.reset()
        raise DeviceError(
            f"{address}: a GenTL producer cannot be loaded ({_text(error)})",
            hint="install its maker's software again, or name another one: producer=FILE.cti",
        ) from error
    return gentl, harvester


def _producers(address: Address) -> list[Path]:
    named = address.options.get("producer")
    if named is not None:
        found = [Path(named)] if Path(named).is_file() else []
        where = named
    else:
        folders = [Path(text) for text in os.environ.get(_PATHS, "").split(os.pathsep) if text]
        found = sorted(file for folder in folders for file in folder.glob("*.cti"))
        where = f"the folders of {_PATHS}" if folders else f"sight, {_PATHS} is not set"
    if not found:
        raise DeviceError(
            f"{address}: there is no GenTL producer in {where}",
            hint="install the software of the camera's maker, which brings a .cti file, and name "
            "it: producer=FILE.cti",
        )
    return found


def _chosen(harvester: Any, address: Address) -> Any:
    devices = harvester.device_info_list
    wanted = address.argument
    for number, device in enumerate(devices):
        if not wanted or wanted in (device.id_, device.serial_number, str(number)):
            return device
    listed = ", ".join(device.id_ for device in devices) or "none"
    raise DeviceError(
        f"{address}: no such camera was found; there are: {listed}",
        hint="check its cable and power, and whether another program has it",
    )


def _text(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
