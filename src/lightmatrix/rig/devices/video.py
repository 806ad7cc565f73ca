"""Web cameras, frame grabbers and whatever else the system plays as video, through PyAV.

FFmpeg reads them: V4L2 on Linux, AVFoundation on macOS, DirectShow on Windows. A thread reads all
the time, so that no old frame waits in the driver.
"""

import re
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.rig.devices.base import Address, AvailableDevice, Camera, Frame, FrameStamps, load

# FFmpeg's input format on each system.
_SYSTEMS = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}
_OPTIONS = ("exposure", "format", "fps", "pixels", "size")
# These options are passed to FFmpeg unchanged.
_FFMPEG_OPTIONS = (
    "channel", "draw_mouse", "grab_x", "grab_y", "input_format", "pixel_format", "rtbufsize",
)  # fmt: skip


class VideoCamera(Camera):
    """A device that delivers frames by itself; made by `open_video`."""

    kind = "video"

    def __init__(self, container: Any, address: Address, exposure: float) -> None:
        super().__init__(address)
        self._container, self._stated = container, exposure
        self._name = f"{container.format.name} {address.argument}"
        self._pixels = address.choice("pixels", ("all", "green"))
        self._stream = container.streams.video[0]
        grey = re.fullmatch(r"gray(?:([0-9]+)le)?", self._stream.format.name)
        self._grey = grey is not None
        self._bits = depth = int(grey[1] or 8) if grey is not None else 8
        self._clip_level = float(2**depth - 1)
        self._shape = (self._stream.height, self._stream.width)
        if not self._grey and self._pixels == "all":
            self._shape += (3,)
        self._stamps = FrameStamps()
        # Older frames are dropped.
        self._frames: deque[tuple[Any, float]] = deque(maxlen=4)
        self._news = threading.Condition()
        self._failure: Exception | None = None
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def get_image(self, timeout: float) -> Frame:
        """The oldest frame that waits, or the next one."""
        until = time.monotonic() + timeout
        with self._news:
            while not self._frames:
                self._check_open()
                left = until - time.monotonic()
                if left <= 0 or not self._news.wait(left):
                    hint = "does another program get pictures? try a smaller size or fps"
                    raise self._timeout(timeout, hint)
            self._check_open()
            picture, timestamp = self._frames.popleft()
        data = picture.to_ndarray(**({} if self._grey else {"format": "rgb24"}))
        if not self._grey and self._pixels == "green":
            data = np.ascontiguousarray(data[..., 1])
        return Frame(data, timestamp, self._clip_level)

    def flush(self) -> None:
        """Discard frames that wait."""
        with self._news:
            self._check_open()
            self._frames.clear()

    def close(self) -> None:
        """Stop reading and give the device back."""
        if self._closed:
            return
        with self._news:
            self._closed = True
            self._frames.clear()
            self._news.notify_all()
        # A device that hangs for longer is left to the end of the program.
        self._reader.join(2.0)
        if not self._reader.is_alive():
            self._container.close()

    def _details(self) -> dict[str, Any]:
        rate = self._stream.average_rate
        return {
            "pixel_format": self._stream.format.name,
            "frames_per_second": float(rate) if rate else None,
        }

    def _read(self) -> None:
        try:
            for picture in self._container.decode(self._stream):
                arrival = time.monotonic()
                timestamp = self._stamps.time(picture.time, arrival)
                with self._news:
                    if self._closed:
                        return
                    self._frames.append((picture, timestamp))
                    self._news.notify_all()
            raise EOFError("it ended")
        # The error is kept for whoever asks for the next frame.
        except Exception as error:
            with self._news:
                self._failure = error
                self._news.notify_all()

    def _check_open(self) -> None:
        super()._check_open()
        if self._failure is not None:
            raise self._error(
                f"the camera is gone ({self._failure})",
                "check its cable, then run the same command again to go on",
            ) from self._failure


def open_video(address: Address) -> VideoCamera:
    """Open a video device by the system's name for it: "video:/dev/video0,exposure=0.01".

    The exposure in seconds is the one that was set on the camera. Further options: size=720x1280,
    rows by columns; fps=30; format, one of FFmpeg's (x11grab, dshow); pixels, which is all (three
    channels of a colour camera, the default) or green. FFmpeg takes input_format, pixel_format,
    channel, rtbufsize, grab_x, grab_y and draw_mouse.
    """
    address.check_options((*_OPTIONS, *_FFMPEG_OPTIONS))
    exposure = address.stated_exposure
    if not address.argument:
        hint = "`lightmatrix rig list` names those that are found: video:/dev/video0"
        raise InputError(f"{address}: which video device?", hint=hint)
    av = load("video", "video devices through PyAV", "av")[0]
    kind = address.options.get("format") or _SYSTEMS.get(sys.platform, "v4l2")
    options = {name: address.options[name] for name in _FFMPEG_OPTIONS if name in address.options}
    if "size" in address.options:
        # FFmpeg has the width first.
        options["video_size"] = "x".join(reversed(address.options["size"].split("x")))
    if "fps" in address.options:
        options["framerate"] = f"{address.number('fps', 0.0):g}"
    if kind == "x11grab":
        options.setdefault("draw_mouse", "0")
    try:
        container = av.open(address.argument, format=kind, options=options)
    except (OSError, ValueError) as error:
        hint = "does another program have it, and are you in the group video? check its name "
        hint += "(`lightmatrix rig list`), size, fps and format"
        raise DeviceError(f"{address}: cannot be opened ({error})", hint=hint) from error
    return VideoCamera(container, address, exposure)


def find_video() -> list[AvailableDevice]:
    """The video devices of Linux; other systems do not list theirs."""
    load("video", "video devices through PyAV", "av")
    devices = []
    for entry in sorted(Path("/sys/class/video4linux").glob("video*")):
        # The device may be unplugged meanwhile.
        with suppress(OSError):
            # Only the first entry of a camera delivers pictures.
            if (entry / "index").read_text().strip() == "0":
                name = (entry / "name").read_text().strip()
                devices.append(AvailableDevice(f"video:/dev/{entry.name}", name))
    return devices
