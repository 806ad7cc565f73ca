"""Pattern sets by name: remade from their descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.mix import MixedPatterns
from lightmatrix.patterns.pattern_set import PatternSet


def from_description(description: Mapping[str, Any]) -> PatternSet | None:
    """Remake a pattern set from its description; None for a set that only its images hold.

    Raises
    ------
    InputError
        On an unknown kind or missing parameters.
    """
    parameters = {key: value for key, value in description.items() if key != "kind"}
    kind = description.get("kind")
    try:
        for key in ("shape", "block"):
            if key in parameters:
                parameters[key] = tuple(int(v) for v in parameters[key])
        if kind == "mix":
            return MixedPatterns(**parameters)
        if kind == "bernoulli":
            return BernoulliPatterns(**parameters)
        if kind == "hadamard":
            return HadamardPatterns(**parameters)
        if kind == "blocks":
            return BlockPatterns(**parameters)
        if kind == "images":
            return None
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a description of {kind} patterns that cannot be read: {error}",
            hint="remove patterns.json to read the patterns from their images",
        ) from error
    raise InputError(
        f"patterns of kind {kind!r} are unknown",
        hint="remove patterns.json to read the patterns from their images",
    )
