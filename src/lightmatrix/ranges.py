"""Numbers within their range, or an InputError that says which would work."""

from __future__ import annotations

import math

from lightmatrix.errors import InputError

# Philox, behind everything random, takes keys of 64 bits.
LARGEST_SEED = 2**64 - 1


def check_number(
    what: str,
    value: float,
    *,
    least: float = 0.0,
    most: float = math.inf,
    above: bool = False,
    hint: str,
) -> None:
    """Refuse a number that is not finite or lies outside of least..most.

    Parameters
    ----------
    what : str
        What it is a number of, as the message says it: "a blur".
    least, most : float
        The permitted range, ends included.
    above : bool
        Whether it must lie above `least` itself.
    hint : str
        What would work.

    Raises
    ------
    InputError
        If it lies outside, or is no number at all.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and least <= number <= most) or (above and number == least):
        raise InputError(f"{what} of {value}", hint=hint)


def check_seed(seed: int) -> None:
    """Refuse seeds that are no whole numbers of 64 bits.

    Raises
    ------
    InputError
        If it is negative, too large, or not whole.
    """
    if not hasattr(seed, "__index__") or not 0 <= int(seed) <= LARGEST_SEED:
        # "0" in quotes, lest it looks like the number.
        shown = seed if hasattr(seed, "__index__") else repr(seed)
        raise InputError(f"a seed of {shown}", hint=f"use a whole number from 0 to {LARGEST_SEED}")


def check_positive(**values: float | None) -> None:
    """Refuse parameters that are not positive and finite; None means automatic."""
    for name, value in values.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", hint="use a positive number")


def check_at_least_one(**values: int | None) -> None:
    """Refuse counts below 1; None means automatic."""
    for name, value in values.items():
        if value is not None and value < 1:
            raise InputError(f"{name} is {value}", hint="use at least 1")
