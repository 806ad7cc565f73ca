"""A folder that another program shows: each image takes the place of the one before."""

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
from lightmatrix.live.devices.projectors.images import check_image

# The one file that the other program watches.
SHOWN = "shown.png"
_SIZE = re.compile(r"([0-9]{1,5})x([0-9]{1,5})")


class FolderProjector:
    """Writes ``shown.png``, whole at any moment; made by `open_folder`."""

    def __init__(self, address: Address, folder: Path, shape: tuple[int, int]) -> None:
        self._address, self._folder, self._shape = address, folder, shape
        self._closed = False
        self.black()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, as the address gives them."""
        return self._shape

    def info(self) -> dict[str, Any]:
        """Name, folder, shape."""
        return {
            "name": f"folder {self._folder}",
            "kind": "folder",
            "shape": self._shape,
            "file": str(self._folder / SHOWN),
        }

    def show(self, image: NDArray[np.uint8]) -> float:
        """Write an image, (rows, cols) or (rows, cols, 3) uint8; when the file was in place.

        When the other program shows it is not known: `lightmatrix rig settle` measures it.

        Raises
        ------
        InputError
            If it is not of the projector's shape, or not uint8.
        OutputError
            If it cannot be written.
        DeviceError
            If the projector is closed.
        """
        if self._closed:
            raise DeviceError(f"{self._address}: is closed", hint="open it again")
        check_image(image, self._shape)
        write_image(self._folder / SHOWN, image, overwrite=True)
        return time.monotonic()

    def black(self) -> float:
        """Show no light, and say when."""
        return self.show(np.zeros(self._shape, np.uint8))

    def close(self) -> None:
        """Write no more; the last image stays."""
        self._closed = True


def open_folder(address: Address) -> FolderProjector:
    """A folder, which is made if need be.

    Parameters
    ----------
    address : Address
        "folder:DIR,size=1024x768", width first as monitors have it.

    Raises
    ------
    InputError
        If the folder or the size is missing or makes no sense.
    OutputError
        If it cannot be written to.
    """
    address.check_options(("size",))
    size = _SIZE.fullmatch(address.options.get("size", ""))
    if not address.argument or size is None or "0" in size.groups():
        raise InputError(
            f"{address}: a folder and its size are needed",
            hint="give folder:DIR,size=WIDTHxHEIGHT, with the pixels of the projector",
        )
    return FolderProjector(address, Path(address.argument), (int(size[2]), int(size[1])))
