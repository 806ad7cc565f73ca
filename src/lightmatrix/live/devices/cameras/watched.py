"""Frames that arrive as files in a folder, from whatever takes them."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import FORMATS, READABLE, read_image
from lightmatrix.live.devices.addresses import Address, size_in_words
from lightmatrix.live.devices.cameras.base import BaseCamera, stated_exposure
from lightmatrix.live.devices.protocols import Frame

# Seconds between two looks at the folder; short beside the time that a file takes to be written.
_POLL = 0.02
# A file is complete if it can be read and did not change for this many seconds. Chosen by hand: it
# covers the pauses of a program that writes to a slow disk.
_QUIET = 0.1
_NUMBER = re.compile(r"([0-9]+)[^0-9]*$")


class WatchedFolder(BaseCamera):
    """Reads the files that appear in a folder; made by `open_watched`."""

    kind = "watch"

    def __init__(self, address: Address, folder: Path, exposure: float, clip: float | None) -> None:
        super().__init__(address)
        self._folder, self._stated, self._clip = folder, exposure, clip
        self._name, self._trigger = f"folder {folder}", "elsewhere"
        self._by_name = address.choice("numbers", ("order", "name"), "order") == "name"
        self._seen = set(self._files())
        self._count = 0

    def get_image(self, timeout: float) -> Frame:
        """The next complete file, timed by its last change, the likeliest end of exposure."""
        self._check_open()
        until = time.monotonic() + timeout
        changes: dict[Path, tuple[tuple[int, int], float]] = {}
        failure: InputError | None = None
        while True:
            # Later files wait for the oldest one.
            for file in self._new_files()[:1]:
                state = _state(file)
                now = time.monotonic()
                if state is None:
                    break
                if file not in changes or changes[file][0] != state:
                    changes[file] = (state, now)
                if now - changes[file][1] >= _QUIET:
                    try:
                        image = read_image(file)
                    # The file is still being written, or damaged; time will tell.
                    except InputError as error:
                        failure = error
                    else:
                        return self._frame(file, image, state)
            if time.monotonic() >= until:
                if failure is None:
                    hint = f"does the other program write {FORMATS} files here?"
                    raise self._timeout(timeout, hint)
                hint = "have files written elsewhere and moved here when they are whole"
                raise self._timeout(timeout, hint, f"; {failure.message}")
            time.sleep(_POLL)

    def flush(self) -> None:
        """Pass over the files that are there."""
        self._check_open()
        passed = self._new_files()
        self._seen.update(passed)
        self._count += len(passed)

    def _files(self) -> list[Path]:
        try:
            return [
                file
                for file in self._folder.iterdir()
                if file.suffix.lower() in READABLE and file.name[0] != "."
            ]
        except OSError as error:
            raise self._error(
                f"the folder cannot be read ({error.strerror})", "check its name and permissions"
            ) from error

    def _new_files(self) -> list[Path]:
        """Files that are not frames yet, the oldest first; those of one moment by name."""
        files = [file for file in self._files() if file not in self._seen]
        states = {file: state for file in files if (state := _state(file)) is not None}
        return sorted(states, key=lambda file: (states[file][1], file.name))

    def _frame(self, file: Path, image: NDArray[Any], state: tuple[int, int]) -> Frame:
        self._seen.add(file)
        self._count += 1
        if image.dtype not in (np.uint8, np.uint16):
            raise DeviceError(
                f"{file}: is {image.dtype}, which no sensor delivers",
                hint="have frames saved with 8 or 16 bits",
            )
        if self._shape is not None and image.shape != self._shape:
            raise DeviceError(
                f"{file}: is {size_in_words(image.shape)}, the frames before were "
                f"{size_in_words(self._shape)}",
                hint="do not turn the camera or change its image size meanwhile",
            )
        self._shape, self._bits = image.shape, 8 * image.dtype.itemsize
        # The wall clock may be set meanwhile, so only its difference to now is used.
        age = max(0.0, time.time() - state[1] * 1e-9)
        clip_level = self._clip or float(np.iinfo(image.dtype).max)
        return Frame(image, self._number(file), time.monotonic() - age, clip_level)

    def _number(self, file: Path) -> int:
        if not self._by_name:
            return self._count
        match = _NUMBER.search(file.stem)
        if match is None:
            raise DeviceError(
                f"{file}: has no number in its name",
                hint="leave out numbers=name, or have frames saved as frame-0001.png",
            )
        return int(match[1])


def open_watched(address: Address) -> WatchedFolder:
    """Open a folder in which frames appear; files that are there already are passed over.

    The address is "watch:DIR,exposure=0.1" with the exposure, in seconds, that was set on the
    camera. The option clip is the largest value where it is not that of 8 or 16 bits (clip=4095).
    numbers=name takes the number at the end of a file's name for the frame's, so that lost frames
    are noticed; numbers=order, the default, counts.
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
    """Size and time of the last change; None if the file was moved away meanwhile."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
