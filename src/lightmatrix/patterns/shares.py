"""Sequences that mix several kinds of frames in given shares, evenly from the first frame on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError


def interleave(shares: Sequence[float], count: int) -> NDArray[np.int64]:
    """Which kind each of a sequence of frames is, such that every prefix has about the shares.

    Webster's rule, frame by frame: the next frame is of the kind whose share is largest for one
    more frame, share / (2 n + 1) after n frames of it; the earlier kind of two equal ones. The
    first k frames do not depend on how many follow.

    Parameters
    ----------
    shares : sequence of float
        Share of each kind, > 0; only their ratios count.
    count : int
        Number of frames K.

    Returns
    -------
    (K,) int64
        Index of the kind of each frame.
    """
    given = np.zeros(len(shares))
    share = np.asarray(shares, np.float64)
    kinds = np.empty(count, np.int64)
    for k in range(count):
        # Shares such as 0.1 and 0.3 are not exact: ties must not hang on the last bit.
        claim = share / (2 * given + 1)
        kinds[k] = int(np.flatnonzero(claim >= claim.max() * (1 - 1e-12))[0])
        given[kinds[k]] += 1
    return kinds


def parse_shares(text: str, what: str, example: str) -> list[tuple[str, float]]:
    """Read ``NAME:SHARE,NAME:SHARE``; a single NAME has the share 1.

    Parameters
    ----------
    text : str
        As given on the command line.
    what, example : str
        For the message: what is listed, and one that works.

    Returns
    -------
    list of (name, share)
        Shares > 0 that sum to 1.

    Raises
    ------
    InputError
        On shares that are no positive numbers or do not sum to 1, or names given twice.
    """
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
