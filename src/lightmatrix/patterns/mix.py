"""Mixes of fine and coarse random patterns.

Fine patterns tell projector pixels apart. A patch of weak light that covers hundreds of pixels
hardly changes between them, since each lights about half of it. A pattern of cells as large as the
patch turns it on and off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import FEWEST_MIXED, MIX_EXAMPLE
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BinaryPatterns, check_random, drawn_bits
from lightmatrix.patterns.pattern_set import check_grid, grid_cells


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
    if len({name for name, _ in listed}) < len(listed):
        raise InputError(f"{what} of {text!r}: a name is there twice", hint="add up its shares")
    total = sum(share for _, share in listed)
    if min(share for _, share in listed) <= 0 or not abs(total - 1) < 1e-3:
        hint = f"use positive shares that sum to 1, for example {example}"
        raise InputError(f"{what} of {text!r}: the shares sum to {total:g}", hint=hint)
    return [(name, share / total) for name, share in listed]


# The coarse grids of the usual mix, and their shares of the patterns; the other patterns are fine.
# docs/planning.md compares the mix with fine patterns.
_COARSE = (((32, 32), 0.125), ((8, 8), 0.125))

Mix = tuple[tuple[tuple[int, int], float], ...]


@dataclass(frozen=True, eq=False)
class MixedPatterns(BinaryPatterns):
    """Random on/off patterns, some lighting single pixels and some whole cells of coarse grids.

    The kinds follow each other so that every prefix of the set holds about the stated shares, and
    the first k patterns do not depend on how many follow. The fine ones are those of
    `BernoulliPatterns` of the same seed and number.

    Parameters
    ----------
    mix : tuple of ((int, int), float)
        Rows and columns of a grid of cells, each lit or dark as a whole, and the share of patterns
        on it, > 0. A grid of the projector's shape makes fine patterns.
    density : float
        Probability that a cell is lit, in (0, 1).
    """

    shape: tuple[int, int]
    count: int
    mix: Mix
    density: float = 0.5
    seed: int = 0

    kind: ClassVar[str] = "mix"

    def __post_init__(self) -> None:
        try:
            mix = tuple(((int(grid[0]), int(grid[1])), float(share)) for grid, share in self.mix)
        except (TypeError, ValueError, LookupError) as error:
            hint = "give ((rows, cols), share) for each grid"
            raise InputError(f"a mix of {self.mix!r:.100}", hint=hint) from error
        object.__setattr__(self, "mix", mix)
        check_random(self.shape, self.count, self.density, self.seed)
        shares = [share for _, share in mix]
        if not mix or min(shares) <= 0 or abs(sum(shares) - 1) > 1e-3:
            hint = f"let them sum to 1, such as {MIX_EXAMPLE}"
            raise InputError(f"a mix with shares {shares}", hint=hint)
        if len({grid for grid, _ in mix}) < len(mix):
            raise InputError("a mix that names one grid twice", hint="add their shares")
        for grid, _ in mix:
            check_grid(self.shape, grid)

    @cached_property
    def kinds(self) -> NDArray[np.int64]:
        """The index of each pattern's entry in `mix`, (K,) int64."""
        return interleave([share for _, share in self.mix], self.count)

    @cached_property
    def bits(self) -> NDArray[np.uint8]:  # type: ignore[override]
        """Lit pixels, (K, ceil(N / 8)) uint8, least significant bit first."""
        cells = [grid_cells(self.shape, grid) for grid, _ in self.mix]
        return drawn_bits(self, self.density, self.seed, cells)


def default_mix(shape: tuple[int, int], count: int) -> Mix:
    """The usual mix for a number of patterns: all fine below 64, then a quarter coarse.

    3/4 are fine, 1/8 have a grid of 32 x 32 and 1/8 of 8 x 8 cells. A grid that is not at least
    twice as coarse as the projector leaves its share to the fine patterns.
    """
    if count < FEWEST_MIXED:
        return ((shape, 1.0),)
    coarse = tuple(
        (grid, share)
        for grid, share in _COARSE
        if 2 * grid[0] <= shape[0] and 2 * grid[1] <= shape[1]
    )
    return ((shape, 1 - sum(share for _, share in coarse)), *coarse)


def parse_mix(text: str, shape: tuple[int, int]) -> Mix:
    """Read a mix such as ``fine:0.75,32x32:0.125,8x8:0.125``."""
    mix = []
    for name, share in parse_shares(text, "a mix", MIX_EXAMPLE):
        rows, _, cols = name.lower().partition("x")
        if name != "fine" and not (rows.isdecimal() and cols.isdecimal()):
            hint = f"write for example {MIX_EXAMPLE}"
            raise InputError(f"a grid called {name!r} in a mix", hint=hint)
        mix.append((shape if name == "fine" else (int(rows), int(cols)), share))
    return tuple(mix)
