"""GigE Vision and USB3 Vision cameras through Aravis."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from lightmatrix.errors import DeviceError, FrameTimeoutError
from lightmatrix.live.devices.addresses import Address, Found, missing_extra
from lightmatrix.live.devices.cameras.exposures import check_exposure
from lightmatrix.live.devices.cameras.formats import PixelFormat, choose_format
from lightmatrix.live.devices.cameras.stamps import Stamps
from lightmatrix.live.devices.protocols import Frame

EXTRA = "aravis"
_BUFFERS = 8
# Frame numbers of GigE Vision have 16 bits unless the camera extends them, and leave 0 out.
_LARGEST_GIGE_ID = 0xFFFF
_SYSTEM = "install Aravis (Debian, Ubuntu: apt-get install gir1.2-aravis-0.8; macOS: brew install "
_SYSTEM += "aravis)"


class AravisCamera:
    """A camera that Aravis drives; made by `open_aravis`."""

    def __init__(self, aravis: Any, error: Any, address: Address) -> None:
        self._aravis, self._error, self._address = aravis, error, address
        self._gone = False
        # The only references: the camera is given back when they end, not when a traceback does.
        self._stream: Any = None
        self._camera: Any = aravis.Camera.new(address.argument or None)
        try:
            with self._talking("be set up"):
                self._set_up()
        except BaseException:
            self.close()
            raise

    def _set_up(self) -> None:
        self._take_control()
        vendor, model = self._camera.get_vendor_name(), self._camera.get_model_name()
        self._name = f"{vendor} {model} {self._camera.get_device_serial_number()}"
        self._set_features()
        self._format = self._set_format()
        self._trigger = self._set_trigger()
        if self._camera.is_gv_device():
            # A network that does not let large packets pass keeps the size that it had.
            with suppress(self._error):
                self._camera.gv_auto_packet_size()
        self._region = self._camera.get_region()
        least, most = self._camera.get_exposure_time_bounds()
        self._exposures = (1e-6 * least, 1e-6 * most)
        largest = _LARGEST_GIGE_ID if self._has_short_ids() else None
        self._stamps = Stamps(largest_id=largest, first_id=1)
        self._stream = self._camera.create_stream(None, None)
        for _ in range(_BUFFERS):
            self._stream.push_buffer(self._aravis.Buffer.new_allocate(self._camera.get_payload()))
        self._camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
        self._camera.start_acquisition()

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, read back from the camera."""
        with self._talking("say its exposure"):
            return float(self._camera.get_exposure_time()) * 1e-6

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        with self._talking("set its exposure"):
            check_exposure(self._address, seconds, *self._exposures)
            self._camera.set_exposure_time(seconds * 1e6)

    def info(self) -> dict[str, Any]:
        """Name, id, shape, pixel format, bits, trigger."""
        _, _, width, height = self._region
        channels = () if self._format.channels == 1 else (self._format.channels,)
        return {
            "name": self._name,
            "kind": "aravis",
            "address": str(self._address),
            "shape": (height, width, *channels),
            "bits": self._format.bits,
            "pixel_format": self._format.name,
            "trigger": self._trigger,
            "shortest_exposure": self._exposures[0],
            "longest_exposure": self._exposures[1],
        }

    def get_image(self, timeout: float) -> Frame:
        """The next frame that came whole.

        Those of which packets were lost are passed over; their numbers are missing from the ids.

        Raises
        ------
        FrameTimeoutError
            If none came in `timeout` seconds.
        DeviceError
            If the camera is closed or gone.
        """
        until = time.monotonic() + timeout
        torn = 0
        while True:
            self._check_open()
            left = max(0.0, until - time.monotonic())
            buffer = self._stream.timeout_pop_buffer(int(left * 1e6))
            if buffer is None:
                raise self._no_frame(timeout, torn)
            try:
                frame_id = self._stamps.count(buffer.get_frame_id())
                if buffer.get_status() == self._aravis.BufferStatus.SUCCESS:
                    return self._frame(buffer, frame_id)
            finally:
                self._stream.push_buffer(buffer)
            torn += 1

    def flush(self) -> None:
        """Throw away frames that arrived but were not yet handed out."""
        self._check_open()
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stamps.count(buffer.get_frame_id())
            self._stream.push_buffer(buffer)

    def trigger(self) -> None:
        """Ask for one frame; nothing unless the camera was opened with trigger=software."""
        self._check_open()
        if self._trigger == "software":
            with self._talking("be triggered"):
                self._camera.software_trigger()

    def close(self) -> None:
        """Stop the camera and give it back."""
        if self._camera is None:
            return
        # Each word to a camera that is gone is waited for, for seconds.
        if not self._gone:
            with suppress(self._error):
                if self._stream is not None:
                    self._camera.stop_acquisition()
                # Left waiting for a trigger, it would seem dead to the next program.
                self._camera.clear_triggers()
        # The stream's thread ends with its last reference, and then the camera's control.
        self._stream = None
        self._camera = None

    def _check_open(self) -> None:
        if self._stream is None:
            raise DeviceError(f"{self._address}: is closed", hint="open the camera again")

    def _frame(self, buffer: Any, frame_id: int) -> Frame:
        # The wall clock may be set meanwhile: only its difference to now is used.
        age = max(0.0, time.time() - buffer.get_system_timestamp() * 1e-9)
        arrival = time.monotonic() - age
        taken = self._stamps.time(buffer.get_timestamp() * 1e-9, arrival)
        rows, cols = buffer.get_image_height(), buffer.get_image_width()
        data = self._format.image(buffer.get_data(), rows, cols)
        return Frame(data, frame_id, taken, self._format.clip_level)

    def _no_frame(self, timeout: float, torn: int) -> DeviceError:
        self._gone = True
        with self._talking("be reached"):
            self._camera.get_exposure_time()
        self._gone = False
        if torn:
            return FrameTimeoutError(
                f"{self._address}: {torn} frames came, but each with packets missing",
                hint="use a wired network, raise its MTU to 9000, or add the option "
                "GevSCPSPacketSize=1400",
            )
        hint = "is the cable of the trigger connected? trigger=software or trigger=free need none"
        if self._trigger in ("free", "software"):
            hint = "a firewall may hold back its packets: see docs/devices.md"
        return FrameTimeoutError(f"{self._address}: no frame within {timeout:g} s", hint=hint)

    def _take_control(self) -> None:
        if self._camera.is_gv_device() and not self._camera.get_device().is_controller():
            # It would not listen to us when it is closed.
            self._gone = True
            raise DeviceError(
                f"{self._address}: another program has the camera",
                hint="close it there; a program that was killed gives it back after some seconds",
            )

    def _set_features(self) -> None:
        """What alters pictures by itself is switched off; then what the user wants is set."""
        off = self._aravis.Auto.OFF
        for available, switch in (
            ("is_exposure_auto_available", "set_exposure_time_auto"),
            ("is_gain_auto_available", "set_gain_auto"),
            ("is_black_level_auto_available", "set_black_level_auto"),
        ):
            if getattr(self._camera, available)():
                getattr(self._camera, switch)(off)
        for name, value in self._address.options.items():
            if not name[0].isupper() or name == "PixelFormat":
                continue
            if not self._camera.is_feature_available(name):
                raise DeviceError(
                    f"{self._address}: the camera has no feature {name}",
                    hint="`arv-tool-0.8 features` lists those that it has",
                )
            try:
                self._camera.get_device().set_features_from_string(f"{name}={value}")
            except self._error as error:
                raise DeviceError(
                    f"{self._address}: {name}={value} was refused ({error.message})",
                    hint="`arv-tool-0.8 values` lists what its features can be",
                ) from error

    def _set_format(self) -> PixelFormat:
        offered = self._camera.dup_available_pixel_formats_as_strings()
        chosen = choose_format(
            str(self._address), offered, self._address.options.get("PixelFormat")
        )
        self._camera.set_pixel_format_from_string(chosen.name)
        return chosen

    def _set_trigger(self) -> str:
        wanted = self._address.options.get("trigger")
        if wanted is None:
            wanted = "software" if self._camera.is_software_trigger_supported() else "free"
        if wanted == "free":
            self._camera.clear_triggers()
            return wanted
        sources = self._camera.dup_available_trigger_sources()
        source = "Software" if wanted == "software" else wanted
        if source not in sources:
            raise DeviceError(
                f"{self._address}: the camera has no trigger {wanted!r}",
                hint=f"its triggers are {', '.join(sources) or 'none'}, and free",
            )
        self._camera.set_trigger(source)
        return wanted

    def _has_short_ids(self) -> bool:
        if not self._camera.is_gv_device():
            return False
        with suppress(self._error):
            return not self._camera.get_device().get_boolean_feature_value("GevGVSPExtendedIDMode")
        return True

    @contextmanager
    def _talking(self, doing: str) -> Iterator[None]:
        """What Aravis says against it becomes ours."""
        if self._camera is None:
            raise DeviceError(f"{self._address}: is closed", hint="open the camera again")
        try:
            yield
        except self._error as error:
            raise DeviceError(
                f"{self._address}: the camera cannot {doing} ({error.message})",
                hint="check its cable and power, and whether another program has it",
            ) from error


def open_aravis(address: Address) -> AravisCamera:
    """A camera that an address names by its id, serial number, or network address.

    Parameters
    ----------
    address : Address
        "aravis:Basler-21211553", "aravis:192.168.1.20", or "aravis" alone: the first that is
        found. The option trigger is software (the default where the camera can), free, or one of
        its inputs, as Line1; options with a capital are its own features: Gain=0, Width=640.

    Raises
    ------
    MissingExtraError
        If PyGObject or Aravis is not installed.
    DeviceError
        If there is no such camera, another program has it, or it refuses a setting.
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


def find_aravis() -> list[Found]:
    """The GigE and USB3 Vision cameras that answer.

    Raises
    ------
    MissingExtraError
        As `open_aravis`.
    """
    aravis, _ = _load()
    aravis.update_device_list()
    found = []
    for index in range(aravis.get_n_devices()):
        words = (aravis.get_device_vendor(index), aravis.get_device_model(index))
        description = " ".join(word for word in words if word)
        description += (
            f", {aravis.get_device_protocol(index)} at {aravis.get_device_address(index)}"
        )
        found.append(Found(f"aravis:{aravis.get_device_id(index)}", description))
    return found


def _load() -> tuple[Any, Any]:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib
    # A ValueError where PyGObject is there but Aravis is not.
    except (ImportError, ValueError) as error:
        raise missing_extra(
            EXTRA, "GigE and USB3 Vision cameras through Aravis", system=_SYSTEM
        ) from error
    return Aravis, GLib.Error
