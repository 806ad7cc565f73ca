"""Folders as devices: images for another program to show, and frames that another program takes."""

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import FORMATS, read_image, write_image
from lightmatrix.files.new_files import NewFiles, State
from lightmatrix.rig.devices import base

# The file that the other program watches.
SHOWN = "shown.png"


class FolderProjector(base.Projector):
    """Writes ``shown.png``, which is a complete image at any moment; made by `open_folder`."""

    def __init__(self, address: base.Address, folder: Path, shape: tuple[int, int]) -> None:
        self._address, self._folder, self._shape = address, folder, shape
        self._closed = False
        self.black()

    def info(self) -> dict[str, Any]:
        """JSON-ready facts."""
        return {
            "name": f"folder {self._folder}",
            "kind": "folder",
            "shape": self._shape,
            "file": str(self._folder / SHOWN),
        }

    def show(self, image: NDArray[np.uint8]) -> float:
        """Write an image; return when the file was in place.

        When the other program shows it is not known; `measure_settle` measures it.
        """
        if self._closed:
            raise DeviceError(f"{self._address}: is closed", hint="open it again")
        base.check_image(image, self._shape)
        write_image(self._folder / SHOWN, image, overwrite=True)
        return time.monotonic()

    def close(self) -> None:
        """Write no more; the last image stays."""
        self._closed = True


def open_folder(address: base.Address) -> FolderProjector:
    """Open "folder:DIR,size=768x1024", rows by columns as everywhere; makes a missing folder."""
    address.check_options(("size",))
    size = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", address.options.get("size", ""))
    if not address.argument or size is None:
        hint = "give folder:DIR,size=ROWSxCOLUMNS, with the pixels of the projector"
        raise InputError(f"{address}: a folder and its size are needed", hint=hint)
    return FolderProjector(address, Path(address.argument), (int(size[1]), int(size[2])))


class WatchedFolder(base.Camera):
    """Reads the files that appear in a folder; made by `open_watched`."""

    kind = "watch"
    patience = 30.0

    def __init__(
        self, address: base.Address, folder: Path, exposure: float, clip: float | None
    ) -> None:
        super().__init__(address)
        self._stated, self._clip = exposure, clip
        self._name, self._trigger = f"folder {folder}", "elsewhere"
        # The oldest first; those of one moment by name.
        self._files = NewFiles(folder, lambda item: (item[1][1], item[0].name))
        self._files.pass_over()

    def get_image(self, timeout: float) -> base.Frame:
        """The next complete file, timed by its last change, the likeliest end of exposure."""
        self._check_open()
        until = time.monotonic() + timeout
        while (found := self._files.next(read_image)) is None:
            if time.monotonic() >= until:
                if self._files.failure is None:
                    endings = self._files.suffix or FORMATS
                    hint = f"does the other program write {endings} files here?"
                    raise self._timeout(timeout, hint)
                hint = "have files written elsewhere and moved here when they are whole"
                raise self._timeout(timeout, hint, f"; {self._files.failure[0].message}")
            time.sleep(0.02)
        return self._frame(*found)

    def flush(self) -> None:
        """Pass over the files that are there."""
        self._check_open()
        self._files.pass_over()

    def _frame(self, file: Path, image: NDArray[Any], state: State) -> base.Frame:
        if image.dtype not in (np.uint8, np.uint16):
            hint = "have frames saved with 8 or 16 bits"
            raise DeviceError(f"{file}: is {image.dtype}, which no sensor delivers", hint=hint)
        if self._shape is not None and image.shape != self._shape:
            raise DeviceError(
                f"{file}: is {base.size_in_words(image.shape)}, the frames before were "
                f"{base.size_in_words(self._shape)}",
                hint="do not turn the camera or change its image size meanwhile",
            )
        self._files.suffix = file.suffix.lower()
        self._shape, self._bits = image.shape, 8 * image.dtype.itemsize
        # The wall clock may be set meanwhile, so only its difference to now is used.
        age = max(0.0, time.time() - state[1] * 1e-9)
        clip_level = self._clip or float(np.iinfo(image.dtype).max)
        return base.Frame(image, time.monotonic() - age, clip_level)


def open_watched(address: base.Address) -> WatchedFolder:
    """Open a folder in which frames appear; files that are there already are passed over.

    A file that is written again is a new frame. All frames have the ending of the first one, so
    that a camera may write each photograph in a second format too.

    The address is "watch:DIR,exposure=0.1" with the exposure, in seconds, that was set on the
    camera. The option clip is the largest value where it is not that of 8 or 16 bits (clip=4095).
    """
    address.check_options(("exposure", "clip"))
    exposure = address.stated_exposure
    clip = address.number("clip", 0.0) if "clip" in address.options else None
    folder = Path(address.argument)
    if not address.argument or not folder.is_dir():
        hint = "make it first, or check the name"
        raise InputError(f"{address}: there is no such folder", hint=hint)
    return WatchedFolder(address, folder, exposure, clip)
