"""Web cameras, frame grabbers and whatever else the system plays as video, through PyAV.

FFmpeg reads them: V4L2 on Linux, AVFoundation on macOS, DirectShow on Windows. A thread reads all
the time, so that no old frame waits in the driver.
"""

from __future__ import annotations

import errno
import re
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.live.devices.addresses import Address, Found, missing_extra
from lightmatrix.live.devices.cameras.exposures import not_ours_to_set, stated_exposure
from lightmatrix.live.devices.cameras.stamps import Stamps
from lightmatrix.live.devices.protocols import Frame

EXTRA = "video"
_SYSTEMS = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}
_OWN = ("exposure", "format", "fps", "pixels", "size")
# Handed on to FFmpeg as they are.
_FFMPEG = ("channel", "draw_mouse", "grab_x", "grab_y", "input_format", "pixel_format", "rtbufsize")
# Frames that wait; older ones are dropped, and their numbers missing.
_KEPT = 4
_GREY = re.compile(r"gray(?:([0-9]+)le)?")
_PATIENCE = 2.0


class VideoCamera:
    """A device that delivers frames by itself; made by `open_video`."""

    def __init__(self, container: Any, address: Address, exposure: float) -> None:
        self._container, self._address, self._exposure = container, address, exposure
        self._pixels = address.choice("pixels", ("all", "green"), "all")
        self._stream = container.streams.video[0]
        grey = _GREY.fullmatch(self._stream.format.name)
        self._grey = grey is not None
        self._bits = int(grey[1] or 8) if grey is not None else 8
        self._shape: tuple[int, ...] = (self._stream.height, self._stream.width)
        if not self._grey and self._pixels == "all":
            self._shape += (3,)
        self._stamps = Stamps()
        self._frames: deque[tuple[Any, int, float]] = deque(maxlen=_KEPT)
        self._news = threading.Condition()
        self._failure: Exception | None = None
        self._closed = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, as the address says it."""
        return self._exposure

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        raise not_ours_to_set(self._address)

    def info(self) -> dict[str, Any]:
        """Name, address, shape, pixel format, bits, frames a second."""
        rate = self._stream.average_rate
        return {
            "name": f"{self._container.format.name} {self._address.argument}",
            "kind": "video",
            "address": str(self._address),
            "shape": self._shape,
            "bits": self._bits,
            "pixel_format": self._stream.format.name,
            "frames_per_second": float(rate) if rate else None,
            "trigger": "free",
            "shortest_exposure": self._exposure,
            "longest_exposure": self._exposure,
        }

    def get_image(self, timeout: float) -> Frame:
        """The oldest frame that waits, or the next one.

        Raises
        ------
        FrameTimeoutError
            If none came in `timeout` seconds.
        DeviceError
            If the camera is closed or gone.
        """
        until = time.monotonic() + timeout
        with self._news:
            while not self._frames:
                self._check_open()
                left = until - time.monotonic()
                if left <= 0 or not self._news.wait(left):
                    raise FrameTimeoutError(
                        f"{self._address}: no frame within {timeout:g} s",
                        hint="does another program get pictures? try a smaller size or fps",
                    )
            self._check_open()
            picture, number, taken = self._frames.popleft()
        return Frame(self._decoded(picture), number, taken, float(2**self._bits - 1))

    def flush(self) -> None:
        """Throw away frames that wait."""
        with self._news:
            self._check_open()
            self._frames.clear()

    def trigger(self) -> None:
        """Nothing: it runs freely."""
        self._check_open()

    def close(self) -> None:
        """Stop reading and give the device back."""
        if self._closed:
            return
        with self._news:
            self._closed = True
            self._frames.clear()
            self._news.notify_all()
        # A device that hangs is left to the end of the program.
        self._reader.join(_PATIENCE)
        if not self._reader.is_alive():
            self._container.close()

    def _read(self) -> None:
        number = 0
        try:
            for picture in self._container.decode(self._stream):
                arrival = time.monotonic()
                taken = self._stamps.time(picture.time, arrival)
                number += 1
                with self._news:
                    if self._closed:
                        return
                    self._frames.append((picture, number, taken))
                    self._news.notify_all()
            raise EOFError("it ended")
        # Kept for whoever asks for the next frame.
        except Exception as error:
            with self._news:
                self._failure = error
                self._news.notify_all()

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError(f"{self._address}: is closed", hint="open the camera again")
        if self._failure is not None:
            raise DeviceError(
                f"{self._address}: the camera is gone ({self._failure})",
                hint="check its cable, then run the same command again to go on",
            ) from self._failure

    def _decoded(self, picture: Any) -> NDArray[Any]:
        if self._grey:
            return picture.to_ndarray()
        colours = picture.to_ndarray(format="rgb24")
        return colours if self._pixels == "all" else np.ascontiguousarray(colours[..., 1])


def open_video(address: Address) -> VideoCamera:
    """A video device that an address names as the system does.

    Parameters
    ----------
    address : Address
        "video:/dev/video0,exposure=0.01", with the exposure that was set on the camera, in
        seconds. Options: size=1280x720, fps=30; format, one of FFmpeg's (x11grab, dshow); pixels
        is all (three channels of a colour camera, the default) or green; input_format,
        pixel_format, channel, rtbufsize, grab_x, grab_y and draw_mouse are handed on to FFmpeg.

    Raises
    ------
    MissingExtraError
        If PyAV is not installed.
    InputError
        If the exposure is missing.
    DeviceError
        If there is no such device, another program has it, or it cannot do that size or rate.
    """
    address.check_options((*_OWN, *_FFMPEG))
    exposure = stated_exposure(address)
    if not address.argument:
        raise InputError(
            f"{address}: which video device?",
            hint="`lightmatrix rig list` names those that are found: video:/dev/video0",
        )
    av = _load()
    kind = address.options.get("format") or _SYSTEMS.get(sys.platform, "v4l2")
    options = {name: address.options[name] for name in _FFMPEG if name in address.options}
    if "size" in address.options:
        options["video_size"] = address.options["size"]
    if "fps" in address.options:
        options["framerate"] = f"{address.number('fps', 0.0):g}"
    if kind == "x11grab":
        options.setdefault("draw_mouse", "0")
    try:
        container = av.open(address.argument, format=kind, options=options)
    except (OSError, ValueError) as error:
        raise _refused(address, error) from error
    return VideoCamera(container, address, exposure)


def find_video() -> list[Found]:
    """The video devices of Linux; other systems do not tell theirs.

    Raises
    ------
    MissingExtraError
        As `open_video`.
    """
    _load()
    found = []
    for entry in sorted(Path("/sys/class/video4linux").glob("video*")):
        # It may be unplugged meanwhile.
        with suppress(OSError):
            # A camera's other entries deliver no pictures.
            if (entry / "index").read_text().strip() == "0":
                name = (entry / "name").read_text().strip()
                found.append(Found(f"video:/dev/{entry.name}", name))
    return found


def _load() -> Any:
    try:
        import av
    except ImportError as error:
        raise missing_extra(EXTRA, "video devices through PyAV") from error
    return av


def _refused(address: Address, error: OSError | ValueError) -> DeviceError:
    number = getattr(error, "errno", None)
    what, hint = f"cannot be opened ({error})", "check its name, size, fps and format"
    if number == errno.EBUSY:
        what, hint = "another program has the camera", "close it there"
    elif number in (errno.EACCES, errno.EPERM):
        what, hint = "no permission", "add yourself to the group video, and log in again"
    elif number == errno.ENOENT:
        what = "there is no such device"
        hint = "`lightmatrix rig list` names those that are found"
    return DeviceError(f"{address}: {what}", hint=hint)
