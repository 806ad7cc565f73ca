"""Cameras of any maker through the GenTL producer that comes with them, by harvesters."""

import logging
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from lightmatrix.errors import DeviceError
from lightmatrix.rig.devices.base import Address, AvailableDevice, Frame, FrameStamps, load
from lightmatrix.rig.devices.genicam import BUFFERS, GenICamCamera, PixelFormat

# The standard's environment variable for the folders of producers.
_PATHS = "GENICAM_GENTL64_PATH"


class GenTLCamera(GenICamCamera):
    """A camera behind a GenTL producer; made by `open_gentl`."""

    kind = "gentl"
    # Harvesters passes on errors of its own kind and of the producer's.
    _refusals = (Exception,)
    _features_hint = "its maker's program lists those that it has"
    _values_hint = "its maker's program says what its features can be"
    _silent_hint = "does its maker's program get pictures? try a smaller one: Width, Height"

    def __init__(self, gentl: Any, harvester: Any, address: Address) -> None:
        super().__init__(address)
        self._harvester = harvester
        self._errors, self._timeouts = (gentl.GenericException,), (gentl.TimeoutException,)
        self._acquirer: Any = None
        self._stamps = FrameStamps()
        with self._opening(), self._talking("be set up"):
            devices, wanted = harvester.device_info_list, address.argument
            for number, device in enumerate(devices):
                if not wanted or wanted in (device.id_, device.serial_number, str(number)):
                    break
            else:
                listed = ", ".join(device.id_ for device in devices) or "none"
                hint = "check its cable and power, and whether another program has it"
                what = f"{address}: no such camera was found; there are: {listed}"
                raise DeviceError(what, hint=hint)
            self._name = f"{device.vendor} {device.model} {device.serial_number}"
            self._acquirer = harvester.create(number)
            self._set_up()

    def _set_up(self) -> None:
        self._configure()
        nodes = self._acquirer.remote_device.node_map
        self._set_shape(int(nodes.Height.value), int(nodes.Width.value))
        self._exposure_node = self._node("ExposureTime") or self._node("ExposureTimeAbs")
        if self._exposure_node is None:
            self._stated = self._address.stated_exposure
        self._acquirer.num_buffers = max(BUFFERS, self._acquirer.min_num_buffers)
        self._acquirer.start()

    def get_image(self, timeout: float) -> Frame:
        """The next complete frame; harvesters passes over the others."""
        self._check_open()
        try:
            with (
                self._talking("deliver frames"),
                self._acquirer.fetch(timeout=max(0.001, timeout)) as buffer,
            ):
                return self._frame(buffer)
        except self._timeouts:
            raise self._silent(timeout) from None

    def flush(self) -> None:
        """Discard frames that arrived but were not yet handed out."""
        self._check_open()
        # No more than the buffers hold: a camera that runs freely goes on meanwhile.
        for _ in range(self._acquirer.num_buffers):
            try:
                with self._talking("be flushed"), self._acquirer.fetch(timeout=0.001):
                    pass
            except self._timeouts:
                return

    def _give_back(self) -> None:
        with suppress(*self._errors):
            if self._acquirer is not None:
                self._acquirer.destroy()
        self._harvester.reset()
        self._acquirer = self._harvester = None

    def _fire(self) -> None:
        self._acquirer.remote_device.node_map.TriggerSoftware.execute()

    def _exposure_range(self) -> tuple[float, float]:
        return float(self._exposure_node.min) * 1e-6, float(self._exposure_node.max) * 1e-6

    def _microseconds(self) -> float:
        return float(self._exposure_node.value)

    def _expose_for(self, microseconds: float) -> None:
        self._exposure_node.value = microseconds

    def _node(self, name: str) -> Any:
        return getattr(self._acquirer.remote_device.node_map, name, None)

    def _frame(self, buffer: Any) -> Frame:
        arrival = time.monotonic()
        stamp = None
        # Some producers do not date their frames.
        with suppress(*self._errors):
            stamp = buffer.module.timestamp_ns * 1e-9
        image = buffer.payload.components[0]
        # The data is copied because the buffer will hold another frame.
        data = self._format.image(image.data.tobytes(), image.height, image.width)
        timestamp = self._stamps.time(stamp, arrival)
        return Frame(data, timestamp, self._format.clip_level)

    def _switch_off_automatics(self) -> None:
        for name in ("ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto"):
            if (node := self._node(name)) is not None:
                # Some cameras have the feature without the value Off.
                with suppress(*self._errors):
                    node.value = "Off"

    def _has_feature(self, name: str) -> bool:
        return self._node(name) is not None

    def _set_feature(self, name: str, value: str) -> None:
        self._node(name).from_string(value)

    def _reason(self, error: Exception) -> str:
        return _one_line(error)

    def _offered_formats(self) -> Sequence[str]:
        return tuple(self._node("PixelFormat").symbolics)

    def _use_format(self, chosen: PixelFormat) -> None:
        self._node("PixelFormat").value = chosen.name

    def _choose_trigger(self) -> str:
        selector = self._node("TriggerSelector")
        if selector is not None and "FrameStart" in selector.symbolics:
            selector.value = "FrameStart"
        return super()._choose_trigger()

    def _has_software_trigger(self) -> bool:
        return self._node("TriggerSoftware") is not None

    def _trigger_sources(self) -> Sequence[str]:
        mode, node = self._node("TriggerMode"), self._node("TriggerSource")
        return () if mode is None or node is None else tuple(node.symbolics)

    def _use_trigger(self, source: str | None) -> None:
        mode = self._node("TriggerMode")
        if source is not None:
            self._node("TriggerSource").value = source
            mode.value = "On"
        elif mode is not None:
            mode.value = "Off"


def open_gentl(address: Address) -> GenTLCamera:
    """Open a camera by its id, serial number or number in the list, or the first one.

    The option producer is the maker's .cti file; by default all files in the folders of
    GENICAM_GENTL64_PATH are loaded. The option trigger is software, free or an input such as Line1.
    The option exposure, in seconds, is for a camera that does not say it. Options with a capital
    are the camera's own features: Gain=0, Width=640.
    """
    address.check_options(("producer", "trigger", "exposure"), features=True)
    gentl, harvester = _harvester(address)
    return GenTLCamera(gentl, harvester, address)


def find_gentl() -> list[AvailableDevice]:
    """The cameras that the installed producers find."""
    _, harvester = _harvester(Address("gentl"))
    devices = []
    for device in harvester.device_info_list:
        words = f"{device.vendor} {device.model}, serial number {device.serial_number}"
        devices.append(AvailableDevice(f"gentl:{device.id_}", words))
    harvester.reset()
    return devices


def _harvester(address: Address) -> tuple[Any, Any]:
    gentl, harvesters = load("gentl", "cameras through GenTL", "genicam.gentl", "harvesters.core")
    producers = _producers(address)
    # Harvesters logs every error that it raises as well.
    logging.getLogger("harvesters").setLevel(logging.CRITICAL)
    harvester = harvesters.Harvester()
    try:
        for producer in producers:
            harvester.add_file(str(producer), check_validity=True)
        harvester.update()
    # A producer is its maker's code and raises errors of any kind.
    except Exception as error:
        harvester.reset()
        raise DeviceError(
            f"{address}: a GenTL producer cannot be loaded ({_one_line(error)})",
            hint="install its maker's software again, or name another one: producer=FILE.cti",
        ) from error
    return gentl, harvester


def _producers(address: Address) -> list[Path]:
    named = address.options.get("producer")
    if named is not None:
        files = [Path(named)] if Path(named).is_file() else []
        where = named
    else:
        folders = [Path(text) for text in os.environ.get(_PATHS, "").split(os.pathsep) if text]
        files = sorted(file for folder in folders for file in folder.glob("*.cti"))
        where = f"the folders of {_PATHS}" if folders else f"sight, {_PATHS} is not set"
    if not files:
        raise DeviceError(
            f"{address}: there is no GenTL producer in {where}",
            hint="install the software of the camera's maker, which brings a .cti file, and name "
            "it: producer=FILE.cti",
        )
    return files


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
