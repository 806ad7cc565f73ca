"""The T of a colour projector on disk: a folder with a store for each primary."""

from __future__ import annotations

from pathlib import Path

from lightmatrix.files.colours import COLOURS, colour_paths
from lightmatrix.outputs.kinds import COLOUR_STORES
from lightmatrix.outputs.writing import atomic_folder
from lightmatrix.store.zarr_store import open as open_store
from lightmatrix.store.zarr_store import save
from lightmatrix.transport.colour import ColourTransport


def save_colour(folder: str | Path, transport: ColourTransport, *, overwrite: bool = False) -> None:
    """Write the T of a colour projector as red.zarr, green.zarr and blue.zarr in a folder.

    Parameters
    ----------
    folder : str or Path
        The folder to make, whole or not at all.
    transport : ColourTransport
        What to write.
    overwrite : bool
        Whether an existing one may be replaced.

    Raises
    ------
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> lm.save_colour("scene", lm.ColourTransport(known, known, known))
    >>> lm.open_colour("scene").camera_shape
    (64, 64)
    """
    with atomic_folder(folder, COLOUR_STORES, overwrite=overwrite) as part:
        for name, one in zip(COLOURS, transport, strict=True):
            save(part / f"{name}.zarr", one)


def open_colour(folder: str | Path) -> ColourTransport:
    """Read the T of a colour projector that `save_colour` or `estimate_colour` wrote.

    Parameters
    ----------
    folder : str or Path
        Holds red.zarr, green.zarr and blue.zarr.

    Raises
    ------
    InputError
        If one of them is missing or damaged.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> lm.save_colour("saved", lm.ColourTransport(known, known, known))
    >>> lm.open_colour("saved").projector_shape
    (64, 64)
    """
    red, green, blue = (open_store(path) for path in colour_paths(folder))
    return ColourTransport(red, green, blue)
