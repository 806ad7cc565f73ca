"""Opening a light transport matrix by the ending of its name."""

from __future__ import annotations

from pathlib import Path

from lightmatrix.store import exchange, zarr_file
from lightmatrix.transport.matrix import LightTransport


def open(path: str | Path) -> LightTransport:
    """Open a light transport matrix: a store (.zarr), or a file of `export` or `render` (.npz).

    Parameters
    ----------
    path : str or Path
        Of a name that does not end in .npz, a store is expected.

    Returns
    -------
    LightTransport

    Raises
    ------
    InputError
        If there is none, or it is incomplete, damaged, or of a later format version.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.save("scene.zarr", lm.truth("metal").transport())
    >>> lm.open("scene.zarr")
    LightTransport(camera 64 x 64, projector 64 x 64, 1922182 entries, metal)
    """
    if Path(path).suffix.lower() == ".npz":
        return exchange.import_npz(path)
    return zarr_file.open(path)
