"""A GigE Vision camera in this process, served by Aravis over the loopback network.

It photographs what a callable says, a virtual screen for instance, as clip(e T p + noise).
"""

from __future__ import annotations

import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

if sys.platform != "win32":
    import fcntl

# At this exposure time e is 1.
UNIT_EXPOSURE = 0.01
_FULL = 65535
# The only address of the loopback network that Aravis serves, so one such camera runs at a time.
_HOST = "127.0.0.1"
_PATIENCE = 120


def _missing() -> str | None:
    try:
        import gi

        gi.require_version("Aravis", "0.8")
    except ImportError:
        return "PyGObject is missing: make test-install"
    except ValueError:
        return "Aravis is missing: make system-deps"
    return None


needs_aravis = pytest.mark.skipif(_missing() is not None, reason=str(_missing()))
_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


def _library() -> Any:
    """Aravis below PyGObject, whose own `set_fill_pattern` crashes."""
    library = ctypes.CDLL("libaravis-0.8.so.0")
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    for name, returned, arguments in (
        ("arv_gv_fake_camera_get_fake_camera", pointer, [pointer]),
        ("arv_fake_camera_set_fill_pattern", None, [pointer, _FILL, pointer]),
        ("arv_fake_camera_get_payload", size, [pointer]),
        ("arv_buffer_get_data", pointer, [pointer, ctypes.POINTER(size)]),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = returned, arguments
    return library


def _alone() -> IO[bytes]:
    """A lock that one process of this machine has at a time.

    Two cameras would both seem to run at the one address, and take packets from each other.
    """
    lock = (Path(tempfile.gettempdir()) / "lightmatrix-simulated-gige.lock").open("ab")
    until = time.monotonic() + _PATIENCE
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except BlockingIOError:
            assert time.monotonic() < until, "another process serves a simulated camera"
            time.sleep(0.1)


class GigECamera:
    """Serves frames over GigE Vision until it is closed.

    `photograph` is called in the camera's thread with the exposure time in seconds, and gives a
    uint16 image of `shape` (rows, cols).
    """

    def __init__(
        self,
        photograph: Callable[[float], NDArray[np.uint16]],
        shape: tuple[int, int],
        *,
        bytes_per_pixel: int = 2,
    ) -> None:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis

        self.shape = shape
        self.errors: list[BaseException] = []
        self._photograph = photograph
        self._bytes = bytes_per_pixel * shape[0] * shape[1]
        self._library = _library()
        self._lock = _alone()
        self._camera: Any = Aravis.GvFakeCamera.new(_HOST, "LIGHTMATRIX")
        assert self._camera.is_running(), "the simulated camera does not start"
        self._fake = self._library.arv_gv_fake_camera_get_fake_camera(hash(self._camera))
        self._fill = _FILL(self._filled)
        self._library.arv_fake_camera_set_fill_pattern(self._fake, self._fill, None)

    @property
    def address(self) -> str:
        """What `open_camera` opens: our size, and quicker than its 25 frames a second."""
        rows, cols = self.shape
        # Width and height first: the rate that is possible depends on them.
        return (
            f"aravis:{_HOST},Width={cols},Height={rows},AcquisitionFrameRate=200,PixelFormat=Mono16"
        )

    def close(self) -> None:
        """Stop serving; as if the camera were unplugged."""
        if self._camera is not None:
            self._library.arv_fake_camera_set_fill_pattern(self._fake, _FILL(), None)
            self._camera = None
            self._lock.close()

    def _filled(self, buffer: int, _user: int, exposure: int, _gain: int, _format: int) -> None:
        try:
            size = ctypes.c_size_t()
            # The size is 0 as long as the buffer was not sent.
            data = self._library.arv_buffer_get_data(buffer, ctypes.byref(size))
            payload = self._library.arv_fake_camera_get_payload(self._fake)
            assert payload == self._bytes, f"the client reads {payload} bytes"
            image = np.ascontiguousarray(self._photograph(exposure * 1e-6))
            assert image.nbytes == payload, f"{image.nbytes} bytes for {payload}"
            ctypes.memmove(data, image.ctypes.data, payload)
        # It would be lost in the camera's thread.
        except BaseException as error:
            self.errors.append(error)


class ScreenRig:
    """Photographs a screen through a light transport matrix: clip(e T p + noise).

    T is in camera full scale per unit of projector pixel, at an exposure of `UNIT_EXPOSURE`. Camera
    and projector have `sides` (rows, cols); the screen shows each projector pixel in a block, from
    a corner (`left`, `top`) of the display on.
    """

    def __init__(
        self,
        matrix: csr_array,
        sides: tuple[int, int],
        cell: int,
        left: int,
        top: int,
        noise: float,
    ) -> None:
        self._matrix, self._sides, self._cell = matrix, sides, cell
        self._noise, self._random = noise, np.random.default_rng(0)
        height, width = cell * sides[0], cell * sides[1]
        self._area = {"left": left, "top": top, "height": height, "width": width}
        import mss

        # Loaded and tried here: in the camera's thread it would take the time of a frame.
        mss.MSS().close()
        self._grabber = mss.MSS
        self._screen: Any = None

    def __call__(self, exposure: float) -> NDArray[np.uint16]:
        """One photograph of what the screen shows now."""
        if self._screen is None:
            # In the thread that photographs: a connection to the screen belongs to one.
            self._screen = self._grabber()
        pixels = np.asarray(self._screen.grab(self._area))[..., 1]
        blocks = pixels.reshape(self._sides[0], self._cell, self._sides[1], self._cell)
        pattern = blocks.mean((1, 3)).ravel() / 255
        light = exposure / UNIT_EXPOSURE * (self._matrix @ pattern)
        light = light + self._noise * self._random.standard_normal(len(light))
        samples = np.clip(np.rint(light * _FULL), 0, _FULL)
        return samples.astype(np.uint16).reshape(self._sides)
