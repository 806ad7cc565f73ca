"""Checks of parameters that several solvers have."""

from __future__ import annotations

import numpy as np

from lightmatrix.errors import InputError


def check_positive(**values: float | None) -> None:
    """Refuse parameters that are not positive; None means automatic."""
    for name, value in values.items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}", hint="use a positive number")


def check_count(**values: int | None) -> None:
    """Refuse counts below 1; None means automatic."""
    for name, value in values.items():
        if value is not None and value < 1:
            raise InputError(f"{name} is {value}", hint="use at least 1")
