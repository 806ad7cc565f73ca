"""A folder that another program shows: each image replaces the one before."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.images import write_image
from lightmatrix.live.devices.addresses import Address
from lightmatrix.live.devices.protocols import check_image

# The file that the other program watches.
SHOWN = "shown.png"
_SIZE = re.compile(r"([0-9]{1,5})x([0-9]{1,5})")


class FolderProjector:
    """Writes ``shown.png``, which is a complete image at any moment; made by `open_folder`."""

    def __init__(self, address: Address, folder: Path, shape: tuple[int, int]) -> None:
        self._address, self._folder, self._shape = address, folder, shape
        self._closed = False
        self.black()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, as the address states them."""
        return self._shape

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

        When the other program shows it is not known; `lightmatrix rig settle` measures it.
        """
        if self._closed:
            raise DeviceError(f"{self._address}: is closed", hint="open it again")
        check_image(image, self._shape)
        write_image(self._folder / SHOWN, image, overwrite=True)
        return time.monotonic()

    def black(self) -> float:
        """Show no light; return when."""
        return self.show(np.zeros(self._shape, np.uint8))

    def close(self) -> None:
        """Write no more; the last image stays."""
        self._closed = True


def open_folder(address: Address) -> FolderProjector:
    """Open "folder:DIR,size=1024x768", width first as monitors have it; makes a missing folder."""
    address.check_options(("size",))
    size = _SIZE.fullmatch(address.options.get("size", ""))
    if not address.argument or size is None or "0" in size.groups():
        raise InputError(
            f"{address}: a folder and its size are needed",
            hint="give folder:DIR,size=WIDTHxHEIGHT, with the pixels of the projector",
        )
    return FolderProjector(address, Path(address.argument), (int(size[2]), int(size[1])))
