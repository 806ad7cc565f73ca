"""Image files that other programs leave in a folder, each read when it is whole."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import READABLE

# Size of a file, and time of its last change in nanoseconds.
State = tuple[int, int]


class NewFiles:
    """Image files of a folder, each once when it is whole, and again when it is written again.

    Those that wait are sorted by `order`, of their paths and states.
    """

    def __init__(self, folder: Path, order: Callable[[tuple[Path, State]], Any]) -> None:
        self._folder, self._order = folder, order
        # The ending of all files, if it is set: that of the first.
        self.suffix = ""
        # States in which files were read, and those seen last, with the time.
        self._read: dict[Path, State] = {}
        self._last: dict[Path, tuple[State, float]] = {}
        # Why the file that is next could not be read at last, and the seconds since it changed.
        self.failure: tuple[InputError, float] | None = None

    def next(self, read: Callable[[Path], NDArray[Any]]) -> tuple[Path, NDArray[Any], State] | None:
        """The next file, as `read` reads it, and its state; None if no file is whole by now."""
        now, waiting, self.failure = time.monotonic(), self._waiting(), None
        for file, state in waiting:
            if self._last.get(file, (None,))[0] != state:
                self._last[file] = state, now
        # Later files wait for it.
        for file, state in waiting[:1]:
            still = now - self._last[file][1]
            # A file is complete if it can be read and did not change for 0.1 s, which covers the
            # pauses of a program that writes to a slow disk.
            if still >= 0.1:
                try:
                    image = read(file)
                # The file is still being written, or damaged; time will tell.
                except InputError as error:
                    self.failure = error, still
                else:
                    if _size_and_time(file) == state:
                        self._read[file] = state
                        return file, image, state
        return None

    def pass_over(self, *, first: bool = False) -> None:
        """Leave out the files that are there, or the first of those that wait."""
        self._read |= dict(self._waiting()[:1]) if first else self._states()

    def _states(self) -> dict[Path, State]:
        """Files that may be frames, with their sizes and the times of their last changes."""
        endings = (self.suffix,) if self.suffix else READABLE
        try:
            files = [
                file
                for file in self._folder.iterdir()
                if file.suffix.lower() in endings and file.name[0] != "."
            ]
        except OSError as error:
            raise DeviceError(
                f"{self._folder}: the folder cannot be read ({error.strerror})",
                hint="check its name and permissions",
            ) from error
        return {file: state for file in files if (state := _size_and_time(file)) is not None}

    def _waiting(self) -> list[tuple[Path, State]]:
        """Files that are new or written again, in order."""
        new = [item for item in self._states().items() if self._read.get(item[0]) != item[1]]
        # Cameras may write one photograph in two formats, under one name.
        best: dict[str, tuple[Path, State]] = {}
        for item in sorted(new, key=lambda item: READABLE.index(item[0].suffix.lower())):
            best.setdefault(item[0].stem, item)
        return sorted(best.values(), key=self._order)


def _size_and_time(file: Path) -> State | None:
    """Size and time of the last change; None if the file was moved away meanwhile."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
