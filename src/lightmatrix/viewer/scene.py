"""One matrix that is being viewed: what the page asks for, and whether its store is still there."""

from __future__ import annotations

import threading
from functools import cached_property
from pathlib import Path

from lightmatrix import store
from lightmatrix.errors import InputError, LightMatrixError
from lightmatrix.store.stored_transport import StoredTransport
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.coarse import CoarseLight
from lightmatrix.viewer.layers import LayerSource
from lightmatrix.viewer.lights import Light, MemoryLight, Progress, StoredLight
from lightmatrix.viewer.matrix_data import matrix_data, matrix_size, white_level
from lightmatrix.viewer.messages import HEADER_BYTES
from lightmatrix.viewer.packed import packed
from lightmatrix.viewer.session import Session

# The largest matrix that a page relights itself. Beyond it, a browser's tab needs gigabytes.
PAGE_BYTES = 512 << 20
_COLOUR_CHANNELS = 3


class Scene:
    """A matrix as the page sees it.

    Parameters
    ----------
    transport : LightTransport, str or Path
        T, or where `open` finds it.
    page_bytes : int
        The largest matrix that is sent to the page. A larger one stays here, and on disk if it is a
        store, which gets an index of its columns.
    progress : callable, optional
        Called with what is done, all there is, and a note, while the index is made.

    Raises
    ------
    InputError
        If there is no such matrix, or a browser cannot show it.
    OutputError
        If the index cannot be written.
    """

    def __init__(
        self,
        transport: LightTransport | str | Path,
        *,
        page_bytes: int = PAGE_BYTES,
        progress: Progress | None = None,
    ) -> None:
        self._path = None if isinstance(transport, LightTransport) else Path(transport)
        self.matrix = opened(transport, page_bytes)
        name = self.matrix.provenance.get("scene", "Light transport")
        self.title = self._path.name if self._path is not None else str(name)
        channels = self.matrix.camera_shape[2:]
        if channels not in ((), (1,), (_COLOUR_CHANNELS,)):
            raise InputError(
                f"{self.title}: a camera with {channels[0]} channels",
                hint=f"the viewer shows 1 or {_COLOUR_CHANNELS}",
            )
        # T where the page does not have it.
        self.light: Light | None = None
        if isinstance(self.matrix, StoredTransport):
            self.light = StoredLight.open(self.matrix.header.place, progress)
        elif page_size(self.matrix) > page_bytes:
            self.light = MemoryLight(self.matrix)
        self._found = self._stamp()
        self._layers = LayerSource(self.matrix if self.light is None else self.light)
        self._coarse: CoarseLight | None = None
        self._coarse_maker: threading.Thread | None = None

    @property
    def most_message(self) -> int:
        """The longest message of the page in bytes: all levels of a pattern or of a picture."""
        rows, cols = self.matrix.camera_shape[:2]
        return HEADER_BYTES + max(self.matrix.shape[1], rows * cols)

    @cached_property
    def description(self) -> bytes:
        """Shapes, layers and colour scales, see `packed`."""
        header = {
            "title": self.title,
            "camera": self.matrix.camera_shape,
            "projector": self.matrix.projector_shape,
            "grid": self.matrix.background_grid,
            "layers": self._layers.available,
            "remote": self.light is not None,
            "white": self._white,
        }
        return packed(header, self._layers.colours)

    @cached_property
    def _white(self) -> float | None:
        """The light that is shown as white, if the page does not compute it."""
        return None if self.light is None else white_level(self.light.white_samples())

    @cached_property
    def matrix_bytes(self) -> bytes:
        """The matrix, see `matrix_data`.

        Raises
        ------
        InputError
            If it is too large for the page.
        """
        if self.light is not None or not isinstance(self.matrix, LightTransport):
            raise InputError("the matrix stays here", hint="ask by messages")
        return matrix_data(self.matrix)

    @property
    def layers(self) -> list[str]:
        """The names of the layers."""
        return list(self._layers.available)

    def layer(self, name: str) -> bytes:
        """A layer, computed when it is first asked for.

        Raises
        ------
        InputError
            If the matrix has no such layer.
        """
        return self._layers.get(name)

    def session(self) -> Session:
        """What a window needs of a matrix that stays here."""
        if self.light is not None and self._coarse_maker is None:
            self._coarse_maker = threading.Thread(target=self._make_coarse, daemon=True)
            self._coarse_maker.start()
        rows, cols = self.matrix.camera_shape[:2]
        projector = self.matrix.projector_shape
        return Session(
            self.light, self._white or 1.0, lambda: self._coarse, (rows, cols), projector
        )

    def _make_coarse(self) -> None:
        assert self.light is not None
        try:
            self._coarse = CoarseLight(self.light)
        except LightMatrixError:
            # The store is gone or damaged: the page learns it from what it asks next.
            return

    def notice(self) -> str:
        """What became of the store since it was read; empty if nothing did."""
        if self._found is None or (now := self._stamp()) == self._found:
            return ""
        rest = "." if self.light is not None else ". The page goes on with what was read of it."
        if now is None:
            return f"{self._path} is gone{rest}"
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


def opened(
    transport: LightTransport | str | Path, page_bytes: int
) -> LightTransport | StoredTransport:
    """The matrix, in memory unless it is a store that is too large for the page."""
    if isinstance(transport, LightTransport):
        return transport
    if not Path(transport).is_dir():
        return store.open(transport)
    stored = StoredTransport.open(transport, memory=0)
    return stored if page_size(stored) > page_bytes else stored.load()


def page_size(matrix: LightTransport | StoredTransport) -> int:
    """Bytes that a matrix takes in the page."""
    entries = matrix.sparse.nnz if isinstance(matrix, LightTransport) else matrix.entries
    cells = matrix.background_grid[0] * matrix.background_grid[1]
    return matrix_size(*matrix.shape, entries, cells)
