"""What else must hold after a command: results compared through the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .case import Check
from .run import Ran, run


def whole_matrix(store: Path) -> NDArray[np.float64]:
    """All of T that a store holds, exported with its background spread."""
    file = store.with_name(f"{store.name}.check.npz")
    ran = run(f"export {store} {file} --dense-background", store.parent)
    if ran.code != 0:
        raise ValueError(f"{store.name} cannot be exported: {ran.err.strip()[:200]}")
    matrix = np.asarray(sparse.load_npz(file).toarray(), np.float64)
    file.unlink()
    return matrix


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
