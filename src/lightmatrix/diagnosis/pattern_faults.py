"""What the patterns can reveal of T at all, and whether they are photographs by mistake."""

from __future__ import annotations

import numpy as np

from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.patterns.stripes import NOTHING, stripes_of

# At most 20 % of the projector pixels may be shown like another one; a few patterns leave some so
# by chance.
_MOST_ALIKE = 0.2
# The first 4 frames are looked at: projected images have up to 4 grey values, photographs have
# noise and thus 24 or more.
_LOOKED_AT, _FEW_GREYS, _MANY_GREYS = 4, 4, 24


def check_distinguishable(patterns: PatternSet) -> list[Finding]:
    """Whether the patterns can tell several footprints in a row, and single pixels, apart."""
    if is_separable(patterns):
        return [
            Finding(
                "stripes",
                (),
                "each pattern varies along rows or along columns only (Gray code, stripes, "
                "fringes): where a camera pixel sees several places, they cannot tell these from "
                "the crossings of their rows and columns",
                "fine for correspondence and shape (lightmatrix decode); for all of T project "
                "random patterns too: lightmatrix patterns bernoulli",
            )
        ]
    alike = _share_alike(patterns)
    if alike > _MOST_ALIKE:
        return [
            Finding(
                "patterns",
                (),
                f"{100 * alike:.0f} % of the projector pixels look like another: all "
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
    frames = range(min(_LOOKED_AT, survey.count))
    drawn = all(len(np.unique(survey.raw[:, k])) <= _FEW_GREYS for k in frames)
    noisy = all(len(np.unique(patterns.rows(k, k + 1))) >= _MANY_GREYS for k in frames)
    if not (drawn and noisy):
        return []
    return [
        Finding(
            "interchanged",
            (),
            "the photographs have a few exact grey values, and the patterns have noise",
            "patterns and photographs seem to be in each other's place: exchange the folders",
        )
    ]


def is_separable(patterns: PatternSet) -> bool:
    """Whether no pattern varies along both rows and columns."""
    if min(patterns.shape) == 1:
        return False
    stripes = stripes_of(patterns)
    return stripes is not None and bool((stripes.axes != NOTHING).any())


def _share_alike(patterns: PatternSet) -> float:
    """Share of the projector pixels that all patterns show like another one."""
    return float(np.mean(np.bincount(patterns.twins)[patterns.twins] > 1))
