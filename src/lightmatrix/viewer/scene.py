"""One matrix that is being viewed: what the page asks for."""

import threading
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.defaults import PAGE_BYTES
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import printable
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.paths import as_path
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.pictures.maps import white_level
from lightmatrix.transport import store
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.store import StoredTransport
from lightmatrix.uses.compensation import compensate
from lightmatrix.viewer.layers import COMPUTED_ENTRIES, LayerSource, matrix_data, page_size
from lightmatrix.viewer.lights import Light, MemoryLight, StageProgress, StoredLight
from lightmatrix.viewer.packed import packed
from lightmatrix.viewer.session import HEADER_BYTES, Session


class ViewedScene:
    """A matrix as the page sees it.

    A matrix of more than `page_bytes` stays here, and on disk if it is a store, which gets an index
    of its columns (`progress` is called meanwhile). The page offers the patterns of `capture`, and
    layers of depth if there is a `geometry`.
    """

    def __init__(
        self,
        transport: LightTransport | str | Path,
        *,
        page_bytes: int = PAGE_BYTES,
        progress: StageProgress | None = None,
        capture: Capture | str | Path | None = None,
        geometry: RigGeometry | str | Path | None = None,
    ) -> None:
        self.matrix = opened(transport, page_bytes)
        name = str(self.matrix.provenance.get("scene", "Light transport"))
        # The name of a file may hold bytes that are no text, which no page can.
        in_memory = isinstance(transport, LightTransport)
        self.title = printable(name if in_memory else as_path(transport).name)
        channels = self.matrix.camera_shape[2:]
        if channels not in ((), (1,), (3,)):
            hint = "the viewer shows 1 or 3"
            raise InputError(f"{self.title}: a camera with {channels[0]} channels", hint=hint)
        # T where the page does not have it.
        self.light: Light | None = None
        known: LightTransport | Light
        if isinstance(self.matrix, StoredTransport):
            known = self.light = StoredLight.open(self.matrix.place, progress)
        elif page_size(self.matrix) > page_bytes:
            known = self.light = MemoryLight(self.matrix)
        else:
            known = self.matrix
        self.layers = LayerSource(known, geometry)
        self._patterns: PatternSet | None = None
        if capture is not None:
            opened_capture = capture if isinstance(capture, Capture) else Capture.open(capture)
            self._patterns = _binned(opened_capture.patterns, self.matrix.projector_shape)
        self._computing = threading.Lock()

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
            "layers": self.layers.available,
            "remote": self.light is not None,
            "white": self._white,
            "frames": self.pattern_count,
            "compensates": self._compensates,
        }
        return packed(header, self.layers.colours)

    @property
    def pattern_count(self) -> int:
        """Patterns of the capture, which the page offers to project again."""
        return 0 if self._patterns is None else self._patterns.count

    def pattern(self, number: int) -> bytes:
        """A pattern of the capture as levels of one byte, see `packed`."""
        if self._patterns is None or not 0 <= number < self.pattern_count:
            raise InputError(f"pattern {number} of {self.pattern_count}", hint="count them from 0")
        image = self._patterns.images(number, number + 1)[0]
        return packed({}, {"levels": np.rint(255 * image).clip(0, 255).astype(np.uint8)})

    @cached_property
    def _white(self) -> float | None:
        """The light that is shown as white, if the page does not compute it."""
        return None if self.light is None else white_level(self.light.white_samples())

    @cached_property
    def matrix_bytes(self) -> bytes:
        """The matrix, see `matrix_data`; refused if it is too large for the page."""
        if self.light is not None or not isinstance(self.matrix, LightTransport):
            raise InputError("the matrix stays here", hint="ask by messages")
        return matrix_data(self.matrix)

    def session(self) -> Session:
        """What a window needs of a matrix that stays here."""
        rows, cols = self.matrix.camera_shape[:2]
        projector = self.matrix.projector_shape
        return Session(
            self.light, self._white or 1.0, (rows, cols), projector,
            self._compensated if self._compensates else None,
        )  # fmt: skip

    @property
    def _compensates(self) -> bool:
        """Whether patterns are computed for pictures, which takes seconds for larger matrices."""
        matrix = self.matrix
        return isinstance(matrix, LightTransport) and matrix.sparse.nnz <= COMPUTED_ENTRIES

    def _compensated(self, levels: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], str]:
        """The pattern under which the camera sees a picture, and how well."""
        assert isinstance(self.matrix, LightTransport)
        # Levels of a picture are seen through the usual gamma of a screen.
        with self._computing:
            found = compensate(self.matrix, levels / np.float32(255), gamma=2.2)
        reached = 100 * float(found.reachable.mean())
        words = f"{reached:.0f} % of the camera pixels reach the picture, at {found.psnr:.0f} dB."
        return np.rint(255 * found.pattern).astype(np.uint8), words


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


def _binned(patterns: PatternSet, shape: tuple[int, int]) -> PatternSet:
    """Patterns with the pixels of a projector that may have been binned for T."""
    if patterns.shape == shape:
        return patterns
    rows, cols = (-(-whole // part) for whole, part in zip(patterns.shape, shape, strict=True))
    if (-(-patterns.shape[0] // rows), -(-patterns.shape[1] // cols)) != shape:
        raise InputError(
            f"a capture with a projector of {patterns.shape[0]} x {patterns.shape[1]}, and a "
            f"matrix with one of {shape[0]} x {shape[1]}",
            hint="give the capture that the matrix was estimated from",
        )
    return patterns.coarse((rows, cols))
