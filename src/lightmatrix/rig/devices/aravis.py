"""GigE Vision and USB3 Vision cameras through Aravis."""

import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from lightmatrix.errors import DeviceError, FrameTimeoutError, MissingExtraError
from lightmatrix.rig.devices.base import Address, AvailableDevice, Frame, FrameStamps
from lightmatrix.rig.devices.genicam import BUFFERS, GenICamCamera, PixelFormat


class AravisCamera(GenICamCamera):
    """A camera that Aravis drives; made by `open_aravis`."""

    kind = "aravis"
    _features_hint = "`arv-tool-0.8 features` lists those that it has"
    _values_hint = "`arv-tool-0.8 values` lists what its features can be"
    _silent_hint = "a firewall may hold back its packets: see docs/devices.md"

    def __init__(self, aravis: Any, error: Any, address: Address) -> None:
        super().__init__(address)
        self._aravis = aravis
        self._errors = self._refusals = (error,)
        self._gone = False
        # Aravis gives the camera back when its last reference ends. No local variable may refer to
        # it: the traceback of an error would keep it alive.
        self._stream: Any = None
        self._camera: Any = aravis.Camera.new(address.argument or None)
        with self._opening(), self._talking("be set up"):
            self._set_up()

    def _set_up(self) -> None:
        if self._camera.is_gv_device() and not self._camera.get_device().is_controller():
            # Closing must not talk to a camera that does not listen to us.
            self._gone = True
            hint = "close it there; a program that was killed gives it back after some seconds"
            raise self._error("another program has the camera", hint)
        vendor, model = self._camera.get_vendor_name(), self._camera.get_model_name()
        self._name = f"{vendor} {model} {self._camera.get_device_serial_number()}"
        self._configure()
        if self._camera.is_gv_device():
            # A network that blocks large packets keeps its packet size.
            with suppress(*self._errors):
                self._camera.gv_auto_packet_size()
        _, _, width, height = self._camera.get_region()
        self._set_shape(height, width)
        shortest, longest = self._camera.get_exposure_time_bounds()
        self._range = (1e-6 * shortest, 1e-6 * longest)
        self._stamps = FrameStamps()
        self._stream = self._camera.create_stream(None, None)
        for _ in range(BUFFERS):
            self._stream.push_buffer(self._aravis.Buffer.new_allocate(self._camera.get_payload()))
        self._camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
        self._camera.start_acquisition()

    def get_image(self, timeout: float) -> Frame:
        """The next complete frame."""
        until = time.monotonic() + timeout
        incomplete = 0
        while True:
            self._check_open()
            left = max(0.0, until - time.monotonic())
            buffer = self._stream.timeout_pop_buffer(int(left * 1e6))
            if buffer is None:
                raise self._no_frame(timeout, incomplete)
            try:
                if buffer.get_status() == self._aravis.BufferStatus.SUCCESS:
                    return self._frame(buffer)
            finally:
                self._stream.push_buffer(buffer)
            incomplete += 1

    def flush(self) -> None:
        """Discard frames that arrived but were not yet handed out."""
        self._check_open()
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _give_back(self) -> None:
        # A camera that is gone delays each command by seconds.
        if not self._gone:
            with suppress(*self._errors):
                if self._stream is not None:
                    self._camera.stop_acquisition()
                # A camera that waits for a trigger would seem dead to the next program.
                self._camera.clear_triggers()
        # The stream's thread ends with its last reference, and then the control of the camera.
        self._stream = self._camera = None

    def _fire(self) -> None:
        self._camera.software_trigger()

    def _exposure_range(self) -> tuple[float, float]:
        return self._range

    def _microseconds(self) -> float:
        return float(self._camera.get_exposure_time())

    def _expose_for(self, microseconds: float) -> None:
        self._camera.set_exposure_time(microseconds)

    def _frame(self, buffer: Any) -> Frame:
        # The wall clock may be set meanwhile, so only its difference to now is used.
        age = max(0.0, time.time() - buffer.get_system_timestamp() * 1e-9)
        arrival = time.monotonic() - age
        timestamp = self._stamps.time(buffer.get_timestamp() * 1e-9, arrival)
        rows, cols = buffer.get_image_height(), buffer.get_image_width()
        data = self._format.image(buffer.get_data(), rows, cols)
        return Frame(data, timestamp, self._format.clip_level)

    def _no_frame(self, timeout: float, incomplete: int) -> DeviceError:
        self._gone = True
        with self._talking("be reached"):
            self._camera.get_exposure_time()
        self._gone = False
        if incomplete:
            return FrameTimeoutError(
                f"{self._address}: {incomplete} frames came, but each with packets missing",
                hint="use a wired network, raise its MTU to 9000, or add the option "
                "GevSCPSPacketSize=1400",
            )
        return self._silent(timeout)

    def _switch_off_automatics(self) -> None:
        for available, switch in (
            ("is_exposure_auto_available", "set_exposure_time_auto"),
            ("is_gain_auto_available", "set_gain_auto"),
            ("is_black_level_auto_available", "set_black_level_auto"),
        ):
            if getattr(self._camera, available)():
                getattr(self._camera, switch)(self._aravis.Auto.OFF)

    def _has_feature(self, name: str) -> bool:
        return bool(self._camera.is_feature_available(name))

    def _set_feature(self, name: str, value: str) -> None:
        self._camera.get_device().set_features_from_string(f"{name}={value}")

    def _reason(self, error: Exception) -> str:
        return str(getattr(error, "message", error))

    def _offered_formats(self) -> Sequence[str]:
        offered: Sequence[str] = self._camera.dup_available_pixel_formats_as_strings()
        return offered

    def _use_format(self, chosen: PixelFormat) -> None:
        self._camera.set_pixel_format_from_string(chosen.name)

    def _has_software_trigger(self) -> bool:
        return bool(self._camera.is_software_trigger_supported())

    def _trigger_sources(self) -> Sequence[str]:
        sources: Sequence[str] = self._camera.dup_available_trigger_sources()
        return sources

    def _use_trigger(self, source: str | None) -> None:
        if source is None:
            self._camera.clear_triggers()
        else:
            self._camera.set_trigger(source)


def open_aravis(address: Address) -> AravisCamera:
    """Open a camera by its id, serial number or network address, or the first one.

    The option trigger is software (the default where the camera can), free, or one of its inputs,
    such as Line1. Options with a capital are the camera's own features: Gain=0, Width=640.
    """
    address.check_options(("trigger",), features=True)
    aravis, error = _load()
    try:
        return AravisCamera(aravis, error, address)
    except error as reason:
        hint = "check its cable and power, and the network's address; `lightmatrix rig list`"
        hint += " names those that are found"
        raise DeviceError(
            f"{address}: no such camera was found ({reason.message})", hint=hint
        ) from reason


def find_aravis() -> list[AvailableDevice]:
    """The GigE and USB3 Vision cameras that answer."""
    aravis, _ = _load()
    aravis.update_device_list()
    devices = []
    for index in range(aravis.get_n_devices()):
        words = (aravis.get_device_vendor(index), aravis.get_device_model(index))
        description = " ".join(word for word in words if word)
        description += (
            f", {aravis.get_device_protocol(index)} at {aravis.get_device_address(index)}"
        )
        devices.append(AvailableDevice(f"aravis:{aravis.get_device_id(index)}", description))
    return devices


def _load() -> tuple[Any, Any]:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib
    # A ValueError means that PyGObject is installed but Aravis is not.
    except (ImportError, ValueError) as error:
        raise MissingExtraError(
            "cameras through Aravis cannot be used, a package is not installed",
            hint="install Aravis (Debian, Ubuntu: apt-get install gir1.2-aravis-0.8; macOS: brew "
            'install aravis), then pip install "lightmatrix[aravis]"',
        ) from error
    return Aravis, GLib.Error
