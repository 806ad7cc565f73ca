"""Exposure times: those that a camera can do, and those that only a person can set."""

from __future__ import annotations

from lightmatrix.errors import DeviceError, InputError
from lightmatrix.live.devices.addresses import Address


def check_exposure(address: Address, seconds: float, least: float, most: float) -> None:
    """Refuse an exposure time that a camera cannot do.

    Raises
    ------
    InputError
        If it is not `least` to `most` seconds.
    """
    # No time is refused for the rounding of the bounds themselves.
    if not least * (1 - 1e-9) <= seconds <= most * (1 + 1e-9):
        raise InputError(
            f"{address}: an exposure of {seconds} s",
            hint=f"the camera can do {least:g} to {most:g} s",
        )


def stated_exposure(address: Address) -> float:
    """The exposure that the user set on the camera itself, in seconds, and says in the address.

    Raises
    ------
    InputError
        If it is missing, or no number above 0.
    """
    if "exposure" not in address.options:
        raise InputError(
            f"{address}: nothing says how long its frames are exposed",
            hint=f"set the exposure on the camera by hand, and say it: {address},exposure=SECONDS",
        )
    return address.number("exposure", 0.0)


def not_ours_to_set(address: Address) -> DeviceError:
    """The error of a camera whose exposure is set elsewhere."""
    return DeviceError(
        f"{address}: its exposure cannot be set from here",
        hint="set it on the camera, and say it in the address: exposure=SECONDS",
    )
