"""Frames that arrive as files in a folder, from whatever takes them."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, FrameTimeoutError, InputError
from lightmatrix.files.images import FORMATS, READABLE, read_image
from lightmatrix.live.devices.addresses import Address, in_words
from lightmatrix.live.devices.cameras.exposures import not_ours_to_set, stated_exposure
from lightmatrix.live.devices.protocols import Frame

_POLL = 0.02
# A file that did not change for so long, and can be read, is whole.
_QUIET = 0.1
_NUMBER = re.compile(r"([0-9]+)[^0-9]*$")


class WatchedFolder:
    """Reads the files that appear; made by `open_watched`."""

    def __init__(self, address: Address, folder: Path, exposure: float, clip: float | None) -> None:
        self._address, self._folder = address, folder
        self._exposure, self._clip = exposure, clip
        self._by_name = address.choice("numbers", ("order", "name"), "order") == "name"
        self._taken = set(self._files())
        self._count = 0
        self._shape: tuple[int, ...] | None = None
        self._bits: int | None = None
        self._closed = False

    @property
    def exposure(self) -> float:
        """Exposure time in seconds, as the address says it."""
        return self._exposure

    @exposure.setter
    def exposure(self, seconds: float) -> None:
        raise not_ours_to_set(self._address)

    def info(self) -> dict[str, Any]:
        """Name, folder; shape and bits once a frame has been seen, None before."""
        return {
            "name": f"folder {self._folder}",
            "kind": "watch",
            "address": str(self._address),
            "shape": self._shape,
            "bits": self._bits,
            "trigger": "elsewhere",
            "shortest_exposure": self._exposure,
            "longest_exposure": self._exposure,
        }

    def get_image(self, timeout: float) -> Frame:
        """The next file that appeared, as soon as it is whole.

        Its time is that of the file's last change, the best that is known of its exposure.

        Raises
        ------
        FrameTimeoutError
            If none appeared in `timeout` seconds, or none was whole by then.
        DeviceError
            If the folder is gone, or the frame is none that a camera takes.
        """
        self._check_open()
        until = time.monotonic() + timeout
        seen: dict[Path, tuple[tuple[int, int], float]] = {}
        failure: InputError | None = None
        while True:
            for file in self._waiting():
                state = _state(file)
                now = time.monotonic()
                if state is None:
                    break
                if file not in seen or seen[file][0] != state:
                    seen[file] = (state, now)
                if now - seen[file][1] >= _QUIET:
                    try:
                        image = read_image(file)
                    # It is still being written, or damaged, which the time will show.
                    except InputError as error:
                        failure = error
                    else:
                        return self._frame(file, image, state)
                # Later ones wait for it.
                break
            if time.monotonic() >= until:
                raise self._no_frame(timeout, failure)
            time.sleep(_POLL)

    def flush(self) -> None:
        """Pass over the files that are there."""
        self._check_open()
        passed = self._waiting()
        self._taken.update(passed)
        self._count += len(passed)

    def trigger(self) -> None:
        """Nothing: another program takes the frames."""
        self._check_open()

    def close(self) -> None:
        """Watch no more."""
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise DeviceError(f"{self._address}: is closed", hint="open it again")

    def _files(self) -> list[Path]:
        try:
            return [
                file
                for file in self._folder.iterdir()
                if file.suffix.lower() in READABLE and file.name[0] != "."
            ]
        except OSError as error:
            raise DeviceError(
                f"{self._address}: the folder cannot be read ({error.strerror})",
                hint="check its name and permissions",
            ) from error

    def _waiting(self) -> list[Path]:
        """New files, the oldest first; those of one moment by name."""
        files = [file for file in self._files() if file not in self._taken]
        states = {file: state for file in files if (state := _state(file)) is not None}
        return sorted(states, key=lambda file: (states[file][1], file.name))

    def _frame(self, file: Path, image: NDArray[Any], state: tuple[int, int]) -> Frame:
        self._taken.add(file)
        self._count += 1
        if image.dtype not in (np.uint8, np.uint16):
            raise DeviceError(
                f"{file}: is {image.dtype}, which no sensor delivers",
                hint="have frames saved with 8 or 16 bits",
            )
        if self._shape is not None and image.shape != self._shape:
            raise DeviceError(
                f"{file}: is {in_words(image.shape)}, the frames before were "
                f"{in_words(self._shape)}",
                hint="do not turn the camera or change its image size meanwhile",
            )
        self._shape, self._bits = image.shape, 8 * image.dtype.itemsize
        # The clock on the wall may be set meanwhile: only its difference to now is used.
        age = max(0.0, time.time() - state[1] * 1e-9)
        clip_level = self._clip or float(np.iinfo(image.dtype).max)
        return Frame(image, self._number(file), time.monotonic() - age, clip_level)

    def _number(self, file: Path) -> int:
        if not self._by_name:
            return self._count
        found = _NUMBER.search(file.stem)
        if found is None:
            raise DeviceError(
                f"{file}: has no number in its name",
                hint="leave out numbers=name, or have frames saved as frame-0001.png",
            )
        return int(found[1])

    def _no_frame(self, timeout: float, failure: InputError | None) -> FrameTimeoutError:
        if failure is not None:
            return FrameTimeoutError(
                f"{self._address}: no frame within {timeout:g} s; {failure.message}",
                hint="have files written elsewhere and moved here when they are whole",
            )
        return FrameTimeoutError(
            f"{self._address}: no frame within {timeout:g} s",
            hint=f"does the other program write {FORMATS} files here?",
        )


def open_watched(address: Address) -> WatchedFolder:
    """A folder in which frames appear; those that are there already are passed over.

    Parameters
    ----------
    address : Address
        "watch:DIR,exposure=0.1", with the exposure that was set on the camera, in seconds. Option
        clip is the largest value where it is not that of 8 or 16 bits (clip=4095); numbers=name
        takes the number at the end of a file's name for its id, so that lost ones are noticed, and
        numbers=order, the default, counts.

    Raises
    ------
    InputError
        If the exposure or the folder is missing.
    """
    address.check_options(("exposure", "clip", "numbers"))
    exposure = stated_exposure(address)
    clip = address.number("clip", 0.0) if "clip" in address.options else None
    folder = Path(address.argument)
    if not address.argument or not folder.is_dir():
        raise InputError(
            f"{address}: there is no such folder", hint="make it first, or check the name"
        )
    return WatchedFolder(address, folder, exposure, clip)


def _state(file: Path) -> tuple[int, int] | None:
    """Size and time of the last change; None of a file that was moved away meanwhile."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns
