"""What patterns can tell of T at all, and patterns that are photographs."""

from __future__ import annotations

import numpy as np

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet

# Rows or columns of a pattern that differ by less are the same.
_SAME = 0.02
# Of the projector pixels; a few patterns leave some alike by chance.
_ALIKE = 0.2
# Projected images have few grey values, photographs have noise.
_FEW, _MANY = 4, 24


def check_patterns(patterns: PatternSet) -> list[Finding]:
    """Whether the patterns can tell rows of T with several footprints, and single pixels."""
    if _separable(patterns):
        return [
            Finding(
                "patterns",
                (),
                "each pattern varies along rows or along columns only (Gray code, stripes, "
                "fringes): where a camera pixel sees several places, they cannot tell these from "
                "the crossings of their rows and columns",
                "fine for correspondence, shape, and surfaces without interreflection; for all of "
                "T project random patterns too: lightmatrix patterns bernoulli",
            )
        ]
    alike = _alike(patterns)
    if alike > _ALIKE:
        return [
            Finding(
                "patterns",
                (),
                f"{100 * alike:.0f} % of the projector pixels cannot be told from another: all "
                "patterns show the same there",
                "project more patterns, or finer ones, or bin the projector (--bin-projector)",
            )
        ]
    return []


def check_interchanged(survey: Survey) -> list[Finding]:
    """Whether the patterns look photographed and the photographs drawn."""
    patterns = survey.patterns
    if not isinstance(patterns, ImagePatterns):
        return []
    looked = range(min(4, survey.count))
    drawn = all(len(np.unique(survey.raw[:, k])) <= _FEW for k in looked)
    taken = all(len(np.unique(patterns.rows(k, k + 1))) >= _MANY for k in looked)
    if not (drawn and taken):
        return []
    return [
        Finding(
            "interchanged",
            (),
            "the photographs have a few exact grey values, and the patterns have noise",
            "patterns and photographs seem to be in each other's place: exchange the folders",
        )
    ]


def _separable(patterns: PatternSet) -> bool:
    """Whether no pattern varies along both rows and columns."""
    if min(patterns.shape) == 1:
        return False
    varies = False
    for _, block in patterns.chunks():
        images = block.reshape(-1, *patterns.shape)
        along = [np.ptp(images, axis=axis).max(axis=1) for axis in (1, 2)]
        if (np.minimum(*along) > _SAME).any():
            return False
        varies = varies or bool((np.maximum(*along) > _SAME).any())
    return varies


def _alike(patterns: PatternSet) -> float:
    """Share of the projector pixels that all patterns show like another one."""
    mix = np.random.default_rng(0).standard_normal(patterns.count)
    seen = np.zeros(patterns.pixels)
    for start, block in patterns.chunks():
        seen += mix[start : start + len(block)] @ block.astype(np.float64)
    seen.sort()
    same = np.diff(seen) < 1e-9 * max(1.0, float(np.abs(seen).max()))
    twin = np.append(same, False) | np.append(False, same)
    return float(twin.mean())
