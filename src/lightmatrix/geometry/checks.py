"""Checks of the numbers that a geometry is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lightmatrix.errors import InputError

Shape = tuple[int, int]


def points_of(points: ArrayLike, size: int) -> NDArray[np.float64]:
    """Points as (n, size) float64."""
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1] != size:
        names = "(col, row)" if size == 2 else "(X, Y, Z)"
        raise InputError(
            f"points of shape {array.shape}", hint=f"give an array (n, {size}) of {names}"
        )
    return array


def numbers(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """An array of finite float64 of a shape."""
    size = " x ".join(map(str, shape))
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {what} holds no numbers", hint=f"give {size} numbers") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(
            f"the {what} has shape {array.shape}, or is not finite",
            hint=f"give {size} finite numbers",
        )
    return array


def distortion(values: ArrayLike, device: str) -> NDArray[np.float64]:
    """Five coefficients; OpenCV leaves out those at the end that are 0."""
    given = np.ravel(np.asarray(values))
    if len(given) > 5 and not np.any(given[5:]):
        given = given[:5]
    if len(given) > 5:
        raise InputError(
            f"the {device}'s distortion has {len(given)} coefficients",
            hint="calibrate with OpenCV's model of five: k1, k2, p1, p2, k3",
        )
    return numbers(np.append(given, np.zeros(5 - len(given))), (5,), f"{device}'s distortion")


def image_shape(shape: Any, device: str) -> Shape:
    """Rows and columns as whole numbers of at least 1."""
    try:
        rows, cols = (int(size) for size in shape)
        whole = (rows, cols) == tuple(shape)
    except (TypeError, ValueError, OverflowError):
        rows = cols = 0
        whole = False
    if not whole or min(rows, cols) < 1:
        raise InputError(
            f"an image size of {shape} of the {device}", hint="give (rows, cols) in pixels"
        )
    return rows, cols
