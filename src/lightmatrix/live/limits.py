"""How short and how long a camera exposes, as far as it says so."""

from __future__ import annotations

from lightmatrix.live.protocols import Camera

# Of a camera that does not say.
_USUAL = 1e-4, 1.0


def exposure_limits(camera: Camera) -> tuple[float, float]:
    """The shortest and the longest exposure of a camera, in seconds.

    They stand in its `info()` as "shortest_exposure" and "longest_exposure"; the longest is cut off
    at ten seconds, beyond which nothing is measured.
    """
    info = camera.info()
    shortest = float(info.get("shortest_exposure") or _USUAL[0])
    longest = float(info.get("longest_exposure") or _USUAL[1])
    return shortest, max(shortest, min(longest, 10.0))
