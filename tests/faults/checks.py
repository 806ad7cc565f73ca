"""What else must hold after a command: results compared through the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .case import Check, Ran
from .zygote import run_command


def whole_matrix(store: Path) -> NDArray[np.float64]:
    """All of T that a store holds, exported with its background spread."""
    file = store.with_name(f"{store.name}.check.npz")
    ran = run_command(["export", str(store), str(file), "--dense-background"], store.parent)
    if ran.code != 0:
        raise ValueError(f"{store.name} cannot be exported: {ran.err.strip()[:200]}")
    matrix = np.asarray(sparse.load_npz(file).toarray(), np.float64)
    file.unlink()
    return matrix


def same_matrix(store: str, other: str) -> Check:
    """Both stores hold the same T, bit for bit."""

    def check(folder: Path, ran: Ran) -> str | None:
        try:
            actual, wanted = whole_matrix(folder / store), whole_matrix(folder / other)
        except ValueError as error:
            return str(error)
        if actual.shape != wanted.shape or not np.array_equal(actual, wanted):
            return f"{store} holds another T than {other}"
        return None

    return check


def near_matrix(store: str, other: str, tolerance: float = 1e-3) -> Check:
    """Both stores hold the same T but for rounding, relative to its norm."""

    def check(folder: Path, ran: Ran) -> str | None:
        try:
            actual, wanted = whole_matrix(folder / store), whole_matrix(folder / other)
        except ValueError as error:
            return str(error)
        if actual.shape != wanted.shape:
            return f"{store} has {actual.shape}, {other} {wanted.shape}"
        off = float(np.linalg.norm(actual - wanted) / np.linalg.norm(wanted))
        return None if off <= tolerance else f"{store} is {100 * off:.1f} % off {other}"

    return check


def if_accepted(check: Check) -> Check:
    """A check for commands that were not refused."""
    return lambda folder, ran: check(folder, ran) if ran.code == 0 else None


def says_not(phrase: str) -> Check:
    """Words that the command must not print."""

    def check(folder: Path, ran: Ran) -> str | None:
        return f"says {phrase!r}" if phrase in ran.err + ran.out else None

    return check


def prints(phrase: str) -> Check:
    """Words that standard output must hold, as they are."""

    def check(folder: Path, ran: Ran) -> str | None:
        return None if phrase in ran.out else f"{phrase!r} is not in {ran.out[:200]!r}"

    return check


def within(seconds: float) -> Check:
    """The command must be quick."""

    def check(folder: Path, ran: Ran) -> str | None:
        return f"took {ran.seconds:.1f} s" if ran.seconds > seconds else None

    return check


def holds(name: str) -> Check:
    """A file or folder must be there."""

    def check(folder: Path, ran: Ran) -> str | None:
        return None if (folder / name).exists() else f"{name} is missing"

    return check


def is_link(name: str) -> Check:
    """A symbolic link must still be one."""

    def check(folder: Path, ran: Ran) -> str | None:
        return None if (folder / name).is_symlink() else f"{name} is no link any more"

    return check


def every(*checks: Check) -> Check:
    """All of several checks."""

    def check(folder: Path, ran: Ran) -> str | None:
        return next((words for one in checks if (words := one(folder, ran))), None)

    return check


def result(ran: Ran) -> dict[str, Any]:
    """The JSON object that a command printed."""
    printed: dict[str, Any] = json.loads(ran.out)
    return printed
