"""How short and how long a camera exposes, as far as it says so."""

from __future__ import annotations

from lightmatrix.live.devices.protocols import Camera

# Of a camera that does not say.
_USUAL = 1e-4, 1.0
# Of the exposure: cameras round what they are asked for, and say what they made of it.
_SAME = 1e-3


def exposure_limits(camera: Camera) -> tuple[float, float]:
    """The shortest and the longest exposure of a camera, in seconds.

    They stand in its `info()` as "shortest_exposure" and "longest_exposure"; the longest is cut off
    at ten seconds, beyond which nothing is measured.
    """
    info = camera.info()
    shortest = float(info.get("shortest_exposure") or _USUAL[0])
    longest = float(info.get("longest_exposure") or _USUAL[1])
    return shortest, max(shortest, min(longest, 10.0))


def same_exposure(one: float, other: float) -> bool:
    """Whether two exposures are one, but for what a camera makes of its digits."""
    return abs(one - other) <= _SAME * other


def set_exposure(camera: Camera, seconds: float) -> float:
    """Set an exposure, or the nearest that the camera has, unless it is set already.

    Cameras whose exposure is set by hand have one only, which must not be set from here.

    Returns
    -------
    float
        What the camera made of it, in seconds.
    """
    shortest, longest = exposure_limits(camera)
    wanted = min(max(seconds, shortest), longest)
    if not same_exposure(camera.exposure, wanted):
        camera.exposure = wanted
    return camera.exposure
