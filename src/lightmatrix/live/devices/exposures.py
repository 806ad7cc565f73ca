"""Exposure times of any camera: its limits, comparing two, and setting one."""

from __future__ import annotations

from lightmatrix.live.devices.protocols import Camera

# A camera that does not state its limits is taken to expose for 0.1 ms to 1 s, which nearly all
# cameras can do.
_USUAL_LIMITS = 1e-4, 1.0
# Longer exposures than this, in seconds, are never used: measuring a rig would take hours.
_LONGEST_USED = 10.0
# Two exposures are the same if they differ by less than this share. Cameras round the value that
# they are asked for, mostly to whole microseconds or lines, and report what they made of it.
_ROUNDING = 1e-3


def exposure_limits(camera: Camera) -> tuple[float, float]:
    """The shortest and the longest exposure of a camera in seconds, as its `info()` states them."""
    info = camera.info()
    shortest = float(info.get("shortest_exposure") or _USUAL_LIMITS[0])
    longest = float(info.get("longest_exposure") or _USUAL_LIMITS[1])
    return shortest, max(shortest, min(longest, _LONGEST_USED))


def same_exposure(one: float, other: float) -> bool:
    """Whether two exposures differ by no more than a camera's rounding."""
    return abs(one - other) <= _ROUNDING * other


def set_exposure(camera: Camera, seconds: float) -> float:
    """Set the camera's nearest exposure, unless it is set already, and return what it is."""
    shortest, longest = exposure_limits(camera)
    wanted = min(max(seconds, shortest), longest)
    if not same_exposure(camera.exposure, wanted):
        camera.exposure = wanted
    return camera.exposure
