"""One matrix that is being viewed: what the page asks for, and whether its store is still there."""

from __future__ import annotations

import threading
from functools import cached_property
from pathlib import Path

from lightmatrix import store
from lightmatrix.errors import InputError
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.layers import LAYERS, available_layers, colour_scale
from lightmatrix.viewer.matrix_data import matrix_data, matrix_size
from lightmatrix.viewer.packed import packed

# The largest matrix that a page relights itself. Beyond it, a browser's tab needs gigabytes.
MOST_BYTES = 512 << 20
_COLOUR_CHANNELS = 3


class Scene:
    """A matrix as the page sees it.

    Parameters
    ----------
    transport : LightTransport, str or Path
        T, or where `open` finds it.

    Raises
    ------
    InputError
        If there is no such matrix, or a browser cannot hold or show it.
    """

    def __init__(self, transport: LightTransport | str | Path) -> None:
        self._path = None if isinstance(transport, LightTransport) else Path(transport)
        self._found = self._stamp()
        self.transport = (
            transport if isinstance(transport, LightTransport) else store.open(transport)
        )
        name = self.transport.provenance.get("scene", "Light transport")
        self.title = self._path.name if self._path is not None else str(name)
        self._lock = threading.Lock()
        self._layers: dict[str, bytes] = {}
        channels = self.transport.camera_shape[2:]
        if channels not in ((), (1,), (_COLOUR_CHANNELS,)):
            raise InputError(
                f"{self.title}: a camera with {channels[0]} channels",
                hint=f"the viewer shows 1 or {_COLOUR_CHANNELS}",
            )
        if self.size > MOST_BYTES:
            raise InputError(
                f"{self.title}: takes {self.size >> 20} MiB in the browser",
                hint=f"at most {MOST_BYTES >> 20} MiB fit: estimate with --bin-projector and "
                "--bin-camera, or a part with --crop",
            )

    @property
    def size(self) -> int:
        """The size of the matrix in the page."""
        samples, pixels = self.transport.shape
        cells = self.transport.background.shape[1]
        return matrix_size(samples, pixels, self.transport.sparse.nnz, cells)

    @cached_property
    def description(self) -> bytes:
        """Shapes, layers and colour scales, see `packed`."""
        header = {
            "title": self.title,
            "camera": self.transport.camera_shape,
            "projector": self.transport.projector_shape,
            "grid": self.transport.background_grid,
            "layers": available_layers(self.transport),
        }
        arrays = {"false": colour_scale("viridis"), "faint": colour_scale("inferno")}
        return packed(header, arrays)

    @cached_property
    def matrix(self) -> bytes:
        """The matrix, see `matrix_data`."""
        return matrix_data(self.transport)

    def layer(self, name: str) -> bytes:
        """A layer, computed when it is first asked for.

        Raises
        ------
        InputError
            If the matrix has no such layer.
        """
        if name not in available_layers(self.transport):
            raise InputError(f"there is no layer {name!r}", hint="choose one of the list")
        with self._lock:
            if name not in self._layers:
                self._layers[name] = LAYERS[name].make(self.transport)
            return self._layers[name]

    def notice(self) -> str:
        """What became of the store since it was read; empty if nothing did."""
        if self._found is None or (now := self._stamp()) == self._found:
            return ""
        if now is None:
            return f"{self._path} is gone. The page goes on with what was read of it."
        return f"{self._path} has changed. Start the viewer again to see what it holds now."

    def _stamp(self) -> tuple[int, int] | None:
        """What tells one version of the file or folder from the next; None if it is not there."""
        if self._path is None:
            return None
        marker = self._path / "zarr.json" if self._path.is_dir() else self._path
        try:
            status = marker.stat()
        except OSError:
            return None
        return status.st_ino, status.st_mtime_ns
