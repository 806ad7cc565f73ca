"""How many photographs there are, and which one is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lightmatrix.check.code_order import CodeLattice, missing_of_code
from lightmatrix.check.finding import Finding
from lightmatrix.check.relation import Relation
from lightmatrix.check.survey import Survey


def check_counts(survey: Survey | None, patterns: int, images: Sequence[Path]) -> Finding:
    """State that the numbers differ, and, with a survey of all, which photograph is missing."""
    count = len(images)
    message = f"{patterns} patterns, but {count} photographs"
    frames = missing_places(survey) if survey is not None and count == patterns - 1 else ()
    if frames:
        which = " or ".join(map(str, frames))
        message += f": that of pattern {which} (counted from 0) is missing"
        if len(frames) == 1 and frames[0] < count:
            message += f", before {images[frames[0]].name}"
    digits = ["".join(c for c in path.stem if c.isdecimal() and c.isascii()) for path in images]
    if digits and all(digits) and not frames:
        numbers = {int(each) for each in digits}
        absent = sorted(set(range(min(numbers), max(numbers) + 1)) - numbers)
        # Names count in steps, and have no gaps, if they leave out more than a quarter.
        if absent and 4 * len(absent) <= count:
            message += f"; their names leave out number {', '.join(map(str, absent[:5]))}"
    advice = (
        "take it again, or leave the pattern out too"
        if count < patterns
        else "remove what is no photograph of a pattern: a test shot, a frame taken twice, the "
        "black frame?"
    )
    return Finding("counts", frames, message, advice)


def missing_places(survey: Survey) -> tuple[int, ...]:
    """Which of K patterns may have no frame among K - 1 frames; empty if unknown."""
    patterns, count = survey.patterns, survey.count
    lattice = CodeLattice.of(survey)
    if lattice is not None:
        return missing_of_code(lattice)
    # Frames after the missing one show the pattern after that of their number.
    first = replace(survey, patterns=patterns.subset(np.arange(count)))
    relation = Relation.of(first) if count >= 16 else None
    if relation is None or len(relation.frames) < count:
        return ()
    excess, place, step = relation.displaced(0)
    return (place,) if excess > 6 and step > 0 else ()
