"""Checks that numbers are in their range, with messages that say what would work."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError

# The largest seed: the random generator Philox has keys of 64 bits.
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
    """Refuse a number that is not finite or lies outside of least..most, ends included.

    With `above`, the number must not equal `least`. `what` names it in the message, as in "a blur".
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and least <= number <= most) or (above and number == least):
        raise InputError(f"{what} of {value}", hint=hint)


def check_type(what: str, value: Any, *kinds: type, hint: str | None = None) -> None:
    """Refuse a value that is of none of the kinds; `what` says in the message what is wanted."""
    if not isinstance(value, kinds):
        raise InputError(
            f"{type(value).__name__} in place of {what}",
            hint=hint or f"give a {' or '.join(kind.__name__ for kind in kinds)}",
        )


def check_seed(seed: int) -> None:
    """Refuse seeds that are not whole numbers of 64 bits."""
    if not hasattr(seed, "__index__") or not 0 <= int(seed) <= LARGEST_SEED:
        # A text such as "0" keeps its quotes, so that it does not look like a number.
        text = seed if hasattr(seed, "__index__") else repr(seed)
        raise InputError(f"a seed of {text}", hint=f"use a whole number from 0 to {LARGEST_SEED}")


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


def check_unmasked(what: str, values: Any) -> None:
    """Refuse a NumPy array with masked values, whose mask would be dropped. `what` names it."""
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(
            f"{what} with {int(np.ma.getmaskarray(values).sum())} masked values",
            hint="give a plain array; which camera pixels count is said by the mask of a capture",
        )


def real_array(what: str, values: Any) -> NDArray[Any]:
    """The array of numbers that anything array-like holds; `what` names it if it holds others."""
    check_unmasked(what, values)
    try:
        array = np.asarray(values)
    except ValueError:
        array = np.empty(0, object)  # Rows of different lengths.
    if array.dtype.kind not in "buif":
        raise InputError(f"{what} of type {array.dtype}", hint="give an array of real numbers")
    return array


def check_finite(what: str, values: Any) -> None:
    """Refuse numbers that are NaN or infinite; `what` names them in the message."""
    if not np.isfinite(values).all():
        raise InputError(f"{what} that are not all finite", hint="replace NaN and infinite values")
