"""Pattern sets by the name of their kind, as the command line and the planner ask for them."""

from __future__ import annotations

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns, one_pixel_patterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.mix import Mix, MixedPatterns, default_mix, parse_mix
from lightmatrix.patterns.pattern_set import PatternSet

KINDS = ("bernoulli", "hadamard", "onepixel", "blocks", "mix")
# Where there is no natural number of patterns.
USUAL_COUNT = 256


def make_patterns(
    kind: str,
    shape: tuple[int, int],
    count: int | None = None,
    *,
    density: float = 0.5,
    mix: str | Mix | None = None,
    order: str = "sequency",
    permute: bool = False,
    block: tuple[int, int] = (8, 8),
    seed: int = 0,
) -> PatternSet:
    """Make a pattern set by the name of its kind.

    Parameters
    ----------
    kind : {"bernoulli", "hadamard", "onepixel", "blocks", "mix"}
        Independent random pixels; Walsh-Hadamard patterns; one pixel lit at a time; one block at a
        time; random patterns of fine and coarse cells.
    shape : (rows, cols)
        Projector pixels.
    count : int, optional
        Number of patterns K. None: 256; all there are for onepixel and blocks.
    density : float
        bernoulli and mix: share of lit pixels, in (0, 1).
    mix : str or sequence of ((rows, cols), share), optional
        mix: grids of cells lit as a whole and their shares of the patterns, such as
        ``fine:0.75,32x32:0.125,8x8:0.125``. None: this, and all fine below 64 patterns.
    order : {"sequency", "natural", "random"}
        hadamard: which come first.
    permute : bool
        hadamard: shuffle the pixels.
    block : (rows, cols)
        blocks: projector pixels of one block.
    seed : int
        Of everything random.

    Returns
    -------
    PatternSet

    Raises
    ------
    InputError
        On an unknown kind, or values that its patterns do not take.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.make_patterns("bernoulli", (16, 24), 40)
    BernoulliPatterns(shape=(16, 24), count=40, density=0.5, seed=0)
    >>> lm.make_patterns("blocks", (16, 24), block=(8, 8)).count
    6
    """
    if mix is not None and kind != "mix":
        raise InputError(f"a mix for {kind} patterns", hint="make patterns of the kind mix")
    wanted = USUAL_COUNT if count is None else count
    if kind == "bernoulli":
        return BernoulliPatterns(shape, wanted, density, seed)
    if kind == "hadamard":
        return HadamardPatterns(shape, wanted, order, permute, seed)
    if kind == "mix":
        shares = default_mix(shape, wanted) if mix is None else mix
        if isinstance(shares, str):
            shares = parse_mix(shares, shape)
        return MixedPatterns(shape, wanted, shares, density, seed)
    if kind == "onepixel":
        return _some(one_pixel_patterns(shape), count, "onepixel", seed)
    if kind == "blocks":
        return _some(BlockPatterns(shape, block), count, "blocks", seed)
    raise InputError(f"patterns of the kind {kind!r}", hint=f"use one of {', '.join(KINDS)}")


def _some(whole: BlockPatterns, count: int | None, kind: str, seed: int) -> BlockPatterns:
    """All patterns, or as many of them as asked for, drawn at random and in their order."""
    if count is None or count == whole.count:
        return whole
    if not 1 <= count <= whole.count:
        raise InputError(
            f"{count} {kind} patterns", hint=f"there are {whole.count}; ask for fewer, or for all"
        )
    chosen = np.sort(np.random.default_rng(seed).permutation(whole.count)[:count])
    return BlockPatterns(whole.shape, whole.block, chosen)
