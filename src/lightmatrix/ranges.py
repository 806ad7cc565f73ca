"""Checks that numbers are in their range, with messages that say what would work."""

import math
import operator
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
    number = as_float(value)
    if not (math.isfinite(number) and least <= number <= most) or (above and number == least):
        # An integer that no float can hold has hundreds of digits.
        raise InputError(f"{what} of {number if math.isinf(number) else value}", hint=hint)


def as_float(value: Any) -> float:
    """A number as float: infinite if it is too large, and NaN if the value is no number."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
    except (TypeError, ValueError):
        return math.nan


def whole(value: Any) -> int | None:
    """A whole number as int; None for anything else, such as 2.0, a text or an array."""
    try:
        return operator.index(value)
    except TypeError:
        return None


def check_list(values: Any, *, hint: str) -> None:
    """Refuse a number or nothing where several things belong."""
    try:
        len(values)
    except TypeError:
        raise InputError(f"a {type(values).__name__} in place of a list", hint=hint) from None


def check_sides(what: str, shape: Any) -> None:
    """Refuse all but (rows, cols) of 1 to 2^31 - 1 pixels; `what` names it in the message.

    Sparse matrices number pixels in 32 bits.
    """
    try:
        sides = [whole(side) or 0 for side in shape]
    except TypeError:
        sides = []
    if len(sides) != 2 or min(sides) < 1:
        hint = "give (rows, cols), both at least 1"
        raise InputError(f"{what} of shape {shape!s:.100}", hint=hint)
    if sides[0] * sides[1] >= 2**31:
        hint = "2147483647 in all is the most"
        raise InputError(f"{what} of {shape[0]!s:.20} x {shape[1]!s:.20} pixels", hint=hint)


def check_whole(what: str, value: Any, *, least: int = 1, most: int = 2**63 - 1, hint: str) -> None:
    """Refuse all but whole numbers from least to most; `what` names the number in the message."""
    number = whole(value)
    if number is None or not least <= number <= most:
        shown = as_float(value) if number is not None and number > 2**63 else value
        raise InputError(f"{shown} {what}", hint=hint)


def check_type(what: str, value: Any, *kinds: type, hint: str | None = None) -> None:
    """Refuse a value that is of none of the kinds; `what` says in the message what is wanted."""
    if not isinstance(value, kinds):
        hint = hint or f"give a {' or '.join(kind.__name__ for kind in kinds)}"
        raise InputError(f"{type(value).__name__} in place of {what}", hint=hint)


def check_seed(seed: int) -> None:
    """Refuse seeds that are not whole numbers of 64 bits."""
    number = whole(seed)
    if number is None or not 0 <= number <= LARGEST_SEED:
        # A text such as "0" keeps its quotes, so that it does not look like a number.
        text = repr(seed) if number is None else as_float(seed)
        raise InputError(f"a seed of {text}", hint=f"use a whole number from 0 to {LARGEST_SEED}")


def check_positive(**values: float | None) -> None:
    """Refuse parameters that are not positive and finite; None means automatic."""
    for name, value in values.items():
        if value is not None and not 0 < as_float(value) < math.inf:
            raise InputError(f"{name} is {value}", hint="use a positive number")


def check_at_least_one(**values: int | None) -> None:
    """Refuse counts below 1; None means automatic."""
    for name, value in values.items():
        if value is not None and not 1 <= (whole(value) or 0) < 2**63:
            raise InputError(f"{name} is {value}", hint="use a whole number, at least 1")


def real_array(what: str, values: Any) -> NDArray[Any]:
    """The array of numbers that anything array-like holds; `what` names it if it holds others."""
    # The mask of a masked array would be dropped.
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(
            f"{what} with {int(np.ma.getmaskarray(values).sum())} masked values",
            hint="give a plain array; which camera pixels count is said by the mask of a capture",
        )
    try:
        array = np.asarray(values)
    except ValueError:
        array = np.empty(0, object)  # Rows of different lengths.
    if array.dtype.kind not in "buif":
        raise InputError(f"{what} of type {array.dtype}", hint="give an array of real numbers")
    return array


def real_numbers(what: str, values: Any) -> NDArray[np.float64]:
    """Numbers as float64; those that are too large for it are infinite. `what` names them."""
    if isinstance(values, int):
        return np.asarray(as_float(values))
    array = real_array(what, values)
    if not array.size:
        raise InputError(f"no {what}", hint="give one number at least")
    return np.asarray(array, np.float64)


def check_finite(what: str, values: Any) -> None:
    """Refuse numbers that are NaN or infinite; `what` names them in the message."""
    if not np.isfinite(values).all():
        raise InputError(f"{what} that are not all finite", hint="replace NaN and infinite values")
