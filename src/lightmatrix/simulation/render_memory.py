"""The memory that a rendering needs."""

from __future__ import annotations

from collections.abc import Callable

from lightmatrix.errors import InputError
from lightmatrix.resources.memory import available_bytes

# This many paths are traced at once. Chosen by hand: they fill all cores and take about 1 GiB.
WAVEFRONT = 1 << 20
# A path in flight holds its ray, throughput and random state (200 bytes) and, at each of at most
# 20 points, a place, a value and the key by which they are sorted (40 bytes in all).
_PATH_BYTES = 200
_POINT_BYTES = 40
_MAX_POINTS = 20
# The renderer and the scene take about this much.
_BASE_BYTES = 256 << 20
# An entry of the result holds a value, a column and the direct part, 4 bytes each; one of the
# three exists twice while blocks are joined.
_ENTRY_BYTES = 16
# If the wanted share of the light needs too much memory, the message suggests one of these.
_SMALLER_KEEPS = (0.99, 0.98, 0.95, 0.9, 0.8, 0.5)


def needed_bytes(size: tuple[int, int], channels: int = 1, entries: int = 1) -> int:
    """Memory that a rendering needs: the paths in flight, and `entries` for each sparse row."""
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
    """Raise InputError if a rendering would not fit; the hint names a setting that would."""
    available = available_bytes()
    needed = needed_bytes(size, channels, entries)
    if needed <= available:
        return
    hint = "use a smaller --size"
    if entries_at is not None:
        hint = "use fewer --spp or a smaller --size"
        for share in _SMALLER_KEEPS:
            smaller = needed_bytes(size, channels, entries_at(share))
            if share < keep and smaller <= available:
                hint = f"use --keep {share:g} (about {smaller / 2**30:.1f} GiB), or fewer --spp"
                break
    raise InputError(
        f"rendering {size[0]}x{size[1]} camera by {projector[0]}x{projector[1]} projector "
        f"pixels needs about {needed / 2**30:.1f} GiB, {available / 2**30:.1f} GiB are free",
        hint=hint,
    )
