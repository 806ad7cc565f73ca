"""What else must hold after a command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm

from .case import Check
from .run import Ran


def whole_matrix(store: Path) -> NDArray[np.float64]:
    """All of T that a store holds, with its background spread."""
    try:
        matrix = lm.open(store).to_matrix(dense_background=True)
    except lm.LightMatrixError as error:
        raise ValueError(f"{store.name} cannot be read: {error}") from error
    return np.asarray(matrix.toarray(), np.float64)


def same_matrix(store: str, other: str, tolerance: float = 0.0) -> Check:
    """Both stores hold the same T: bit for bit, or but for a share of its norm."""

    def check(folder: Path, ran: Ran) -> str | None:
        try:
            actual, wanted = whole_matrix(folder / store), whole_matrix(folder / other)
        except ValueError as error:
            return str(error)
        if actual.shape != wanted.shape:
            return f"{store} has {actual.shape}, {other} {wanted.shape}"
        off = float(np.linalg.norm(actual - wanted) / np.linalg.norm(wanted))
        return None if off <= tolerance else f"{store} is {100 * off:.2g} % off {other}"

    return check


def if_accepted(check: Check) -> Check:
    """A check for commands that were not refused."""
    return lambda folder, ran: check(folder, ran) if ran.code == 0 else None


def says_not(*phrases: str) -> Check:
    """Words that the command must not print."""

    def check(folder: Path, ran: Ran) -> str | None:
        return next((f"says {p!r}" for p in phrases if p in ran.err + ran.out), None)

    return check


def prints(*phrases: str) -> Check:
    """Words that standard output must hold, as they are."""

    def check(folder: Path, ran: Ran) -> str | None:
        return next(
            (f"{p!r} is not in {ran.out[:200]!r}" for p in phrases if p not in ran.out), None
        )

    return check


def holds(name: str) -> Check:
    """A file or folder must be there."""
    return lambda folder, ran: None if (folder / name).exists() else f"{name} is missing"
