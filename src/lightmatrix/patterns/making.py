"""Pattern sets made by the name of their kind, or remade from their description."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lightmatrix.defaults import USUAL_COUNT
from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.grey import grey_patterns, usual_levels
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.mix import Mix, MixedPatterns, default_mix, parse_mix
from lightmatrix.patterns.pattern_set import PatternSet, check_geometry
from lightmatrix.patterns.stripes import GrayCodePatterns, MicroPhasePatterns, PhasePatterns

# Those of stripes, from which `decode` finds the correspondence.
CODES = ("graycode", "phase", "microphase")
KINDS = ("bernoulli", "random", "hadamard", "onepixel", "blocks", "mix", *CODES)

# The kinds in descriptions. Patterns of the kind "images" are only in their images.
_DESCRIBED: Mapping[str, Callable[..., PatternSet]] = {
    each.kind: each
    for each in (
        BernoulliPatterns, BlockPatterns, GrayCodePatterns, HadamardPatterns, MicroPhasePatterns,
        MixedPatterns, PhasePatterns,
    )
}  # fmt: skip


def make_patterns(
    kind: str,
    shape: tuple[int, int],
    count: int | None = None,
    *,
    density: float = 0.5,
    levels: int | None = None,
    mix: str | Mix | None = None,
    order: str = "sequency",
    permute: bool = False,
    block: tuple[int, int] = (8, 8),
    inverse: bool = False,
    period: float | None = None,
    seed: int = 0,
) -> PatternSet:
    """Make a pattern set by the name of its kind.

    Parameters
    ----------
    kind : {"bernoulli", "random", "hadamard", "onepixel", "blocks", "mix", or one of stripes}
        Independent random pixels; these in grey levels, which suit fewer than 16 patterns;
        Walsh-Hadamard patterns; one pixel lit at a time; one block at a
        time; random patterns of fine and coarse cells. Or stripes for `decode`: "graycode", "phase"
        (shifts with Gray code), "microphase".
    shape : (rows, cols)
        Projector pixels.
    count : int, optional
        Number of patterns K. None: 256; all there are for onepixel and blocks; 14 for microphase.
        graycode and phase have as many as the projector needs.
    density : float
        bernoulli and mix: share of lit pixels, in (0, 1).
    levels : int, optional
        random: number of grey levels, 2 to 256. None: 2 from sixteen patterns on, which are
        bernoulli patterns, else 3, or 4 where these are too few to tell pixels apart. A projector's
        curve and its sharpening change grey patterns, and not black and white ones.
    mix : str or sequence of ((rows, cols), share), optional
        mix: grids of cells lit as a whole and their shares of the patterns, such as
        ``fine:0.75,32x32:0.125,8x8:0.125``. None: this, and all fine below 64 patterns.
    order : {"sequency", "natural", "random"}
        hadamard: which come first.
    permute : bool
        hadamard: shuffle the pixels.
    block : (rows, cols)
        blocks: projector pixels of one block.
    inverse : bool
        graycode and phase: each bit is followed by its inverse.
    period : float, optional
        phase and microphase: projector pixels of a (mean) period. None: 8 and 16.
    seed : int
        Seed of everything random.

    Returns
    -------
    PatternSet

    Raises
    ------
    InputError
        On an unknown kind, or values that are out of range for it.

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
    if levels is not None and kind != "random":
        raise InputError(f"levels for {kind} patterns", hint="make patterns of the kind random")
    if kind in CODES:
        given: dict[str, Any] = {} if period is None else {"period": period}
        if kind == "microphase":
            return MicroPhasePatterns(shape, **given | ({} if count is None else {"total": count}))
        code: PatternSet = GrayCodePatterns(shape, inverse)
        if kind == "phase":
            code = PhasePatterns(shape, inverse=inverse, **given)
        if count is not None and count != code.count:
            hint = f"leave the number out: this code has {code.count}"
            raise InputError(f"{count} {kind} patterns", hint=hint)
        return code
    number = USUAL_COUNT if count is None else count
    check_geometry(shape, number)
    if kind == "random":
        levels = usual_levels(number, shape[0] * shape[1]) if levels is None else levels
        if levels != 2:
            return grey_patterns(shape, number, levels, seed)
    if kind in ("bernoulli", "random"):
        return BernoulliPatterns(shape, number, density, seed)
    if kind == "hadamard":
        return HadamardPatterns(shape, number, order, permute, seed)
    if kind == "mix":
        shares = default_mix(shape, number) if mix is None else mix
        if isinstance(shares, str):
            shares = parse_mix(shares, shape)
        return MixedPatterns(shape, number, shares, density, seed)
    if kind not in ("onepixel", "blocks"):
        raise InputError(f"patterns of the kind {kind!r}", hint=f"use one of {', '.join(KINDS)}")
    whole = BlockPatterns(shape, (1, 1) if kind == "onepixel" else block)
    if count is None or count == whole.count:
        return whole
    if not 1 <= count <= whole.count:
        hint = f"there are {whole.count}; ask for fewer, or for all"
        raise InputError(f"{count} {kind} patterns", hint=hint)
    # Some of them are drawn at random, and kept in their order.
    chosen = np.sort(np.random.default_rng(seed).permutation(whole.count)[:count])
    return BlockPatterns(whole.shape, whole.block, chosen)


def remake_patterns(description: Mapping[str, Any]) -> PatternSet | None:
    """Remake a pattern set from its description; None for a set that only its images describe."""
    parameters = {key: value for key, value in description.items() if key != "kind"}
    kind = description.get("kind")
    if kind == PatternSet.kind:
        return None
    if not isinstance(kind, str) or kind not in _DESCRIBED:
        hint = "remove patterns.json to read the patterns from their images"
        raise InputError(f"patterns of kind {kind!r} are unknown", hint=hint)
    try:
        for key in ("shape", "block"):
            if key in parameters:
                parameters[key] = tuple(int(v) for v in parameters[key])
        return _DESCRIBED[kind](**parameters)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a description of {kind} patterns that cannot be read: {error}",
            hint="remove patterns.json to read the patterns from their images",
        ) from error
