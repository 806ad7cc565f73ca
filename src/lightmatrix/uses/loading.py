"""T in memory for a use that needs all of it, or a message that says what would work."""

from pathlib import Path

from lightmatrix.errors import InputError
from lightmatrix.paths import as_path
from lightmatrix.ranges import check_finite
from lightmatrix.resources.memory import check_memory
from lightmatrix.transport import store
from lightmatrix.transport.matrix import LightTransport

Transport = LightTransport | store.StoredTransport | str | Path


def loaded(source: Transport, times: float) -> LightTransport:
    """The matrix, checked; an InputError if a use that takes `times` its memory does not fit."""
    if isinstance(source, LightTransport):
        # A store was checked when it was read.
        check_finite("entries of T", source.sparse.data)
        check_finite("entries of T", source.background)
        return source
    if not isinstance(source, store.StoredTransport | str | Path):
        raise InputError(
            f"{type(source).__name__} in place of a light transport matrix",
            hint="give what `estimate` or `open` returned, a .zarr folder, or "
            "lm.LightTransport.from_matrix(matrix, camera_shape, projector_shape)",
        )
    if isinstance(source, str | Path):
        if as_path(source).suffix.lower() == ".npz":
            return store.open(source)
        # Nothing is kept: the matrix is loaded whole below.
        source = store.StoredTransport.open(source, memory=0)
    needed = times * sum(array.bytes for array in source.arrays.values())
    check_memory(
        source.place,
        needed,
        "all of the matrix is needed at once: take a part of the camera "
        "(lm.StoredTransport.open(...).crop), estimate with the camera's pixels binned, or use a "
        "machine with more memory",
    )
    return source.load()
