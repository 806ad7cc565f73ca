"""Sequences of frames of several kinds, each with its share of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError


def interleave(shares: Sequence[float], count: int) -> NDArray[np.int64]:
    """The index of the kind of each of K frames, (K,), so that every prefix has about the shares.

    Webster's method: the next frame is of the kind with the largest share / (2 n + 1), where n
    frames are of this kind already. The first k frames do not depend on how many follow.
    """
    counts = np.zeros(len(shares))
    share = np.asarray(shares, np.float64)
    kinds = np.empty(count, np.int64)
    for k in range(count):
        quotients = share / (2 * counts + 1)
        # Shares such as 0.1 are rounded, and the last bit must not decide between equal quotients.
        kinds[k] = int(np.flatnonzero(quotients >= quotients.max() * (1 - 1e-12))[0])
        counts[kinds[k]] += 1
    return kinds


def parse_shares(text: str, what: str, example: str) -> list[tuple[str, float]]:
    """Read ``NAME:SHARE,NAME:SHARE`` (sum 1) or a single NAME; messages give an `example`."""
    parts = [part.strip().partition(":") for part in text.split(",")]
    if len(parts) == 1 and not parts[0][1]:
        parts = [(parts[0][0], ":", "1")]
    try:
        listed = [(name.strip(), float(share)) for name, _, share in parts]
    except ValueError:
        raise InputError(f"{what} of {text!r}", hint=f"write for example {example}") from None
    total = sum(share for _, share in listed)
    if min(share for _, share in listed) <= 0 or not abs(total - 1) < 1e-3:
        raise InputError(
            f"{what} of {text!r}: the shares sum to {total:g}",
            hint=f"use positive shares that sum to 1, for example {example}",
        )
    if len({name for name, _ in listed}) < len(listed):
        raise InputError(f"{what} of {text!r}: one is given twice", hint="give each once")
    return [(name, share / total) for name, share in listed]
