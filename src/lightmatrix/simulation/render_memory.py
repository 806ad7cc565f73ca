"""The memory that a rendering needs, foreseen, and what to do where there is less."""

from __future__ import annotations

from collections.abc import Callable

from lightmatrix.errors import InputError
from lightmatrix.resources.memory import available_bytes

# Paths in flight. Each holds its ray, throughput and random state, and at each of its points, in
# the renderer and in NumPy, a place, a value and the key they are sorted by.
WAVEFRONT = 1 << 20
_PATH_BYTES = 200
_POINT_BYTES = 40
_MAX_POINTS = 20
# The renderer itself and the scene.
_BASE_BYTES = 256 << 20
# An entry of the result: value, column and direct part, and one of them again while blocks join.
_ENTRY_BYTES = 16
# Shares of the energy that are tried where the wanted one needs more memory than there is.
_KEEPS = (0.99, 0.98, 0.95, 0.9, 0.8, 0.5)


def foreseen_bytes(size: tuple[int, int], channels: int = 1, entries: int = 1) -> int:
    """Memory a rendering needs: the paths in flight, and `entries` for each sparse row."""
    paths = WAVEFRONT * (_PATH_BYTES + _POINT_BYTES * _MAX_POINTS)
    return _BASE_BYTES + paths + size[0] * size[1] * channels * entries * _ENTRY_BYTES


def check_memory(
    size: tuple[int, int],
    projector: tuple[int, int],
    channels: int,
    entries: int = 1,
    entries_at: Callable[[float], int] | None = None,
    keep: float = 1.0,
) -> None:
    """Refuse a rendering that would not fit.

    Parameters
    ----------
    entries : int
        Entries of a sparse row at the share `keep` of its energy.
    entries_at : callable, optional
        Those at any other share, to say which one would fit.

    Raises
    ------
    InputError
        With a share, a number of samples or a size that would do.
    """
    available = available_bytes()
    needed = foreseen_bytes(size, channels, entries)
    if needed <= available:
        return
    hint = "use a smaller --size"
    if entries_at is not None:
        hint = "use fewer --spp or a smaller --size"
        for share in _KEEPS:
            then = foreseen_bytes(size, channels, entries_at(share))
            if share < keep and then <= available:
                hint = f"use --keep {share:g} (about {then / 2**30:.1f} GiB), or fewer --spp"
                break
    raise InputError(
        f"rendering {size[0]}x{size[1]} camera by {projector[0]}x{projector[1]} projector "
        f"pixels needs about {needed / 2**30:.1f} GiB, {available / 2**30:.1f} GiB are free",
        hint=hint,
    )
