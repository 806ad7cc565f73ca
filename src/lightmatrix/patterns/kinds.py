"""Pattern sets by name: remade from their descriptions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lightmatrix.errors import InputError
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.blocks import BlockPatterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.mix import MixedPatterns
from lightmatrix.patterns.pattern_set import PatternSet

# Remade from what their descriptions say. Patterns of the kind "images" are only in their images.
KINDS: Mapping[str, Callable[..., PatternSet]] = {
    "bernoulli": BernoulliPatterns,
    "blocks": BlockPatterns,
    "hadamard": HadamardPatterns,
    "mix": MixedPatterns,
}
IMAGES = "images"


def from_description(description: Mapping[str, Any]) -> PatternSet | None:
    """Remake a pattern set from its description; None for a set that only its images hold.

    Raises
    ------
    InputError
        On an unknown kind or missing parameters.
    """
    parameters = {key: value for key, value in description.items() if key != "kind"}
    kind = description.get("kind")
    if kind == IMAGES:
        return None
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(
            f"patterns of kind {kind!r} are unknown",
            hint="remove patterns.json to read the patterns from their images",
        )
    try:
        for key in ("shape", "block"):
            if key in parameters:
                parameters[key] = tuple(int(v) for v in parameters[key])
        return KINDS[kind](**parameters)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"a description of {kind} patterns that cannot be read: {error}",
            hint="remove patterns.json to read the patterns from their images",
        ) from error
