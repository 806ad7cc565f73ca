"""All terms, in the order in which they are taken out of the patterns and of the photographs."""

from __future__ import annotations

from collections.abc import Sequence

from lightmatrix.rig_model.frames import (
    Ambient,
    DynamicContrast,
    Gain,
    Previous,
    Rows,
    Shift,
    Torn,
    Zoom,
)
from lightmatrix.rig_model.levels import Black, CameraCurve, ProjectorCurve, ToneMapping
from lightmatrix.rig_model.neighbours import CameraBlur, CameraSharpening, Crosstalk, Sharpening
from lightmatrix.rig_model.term import Term

TERMS: dict[str, type[Term]] = {
    each.name: each
    for each in (
        ProjectorCurve,
        Sharpening,
        Crosstalk,
        Previous,
        CameraSharpening,
        Shift,
        Zoom,
        DynamicContrast,
        Gain,
        Rows,
        Ambient,
        ToneMapping,
        CameraCurve,
        Black,
        Torn,
        CameraBlur,
    )
}


def allowed_terms(names: Sequence[str]) -> tuple[str, ...] | None:
    """The terms of some names that a user may give; None if one of them is no name."""
    names = ["gain" if name == "exposure" else name for name in names]
    found = {name for name, term in TERMS.items() if name in names or term.label in names}
    known = found | {TERMS[name].label for name in found}
    return tuple(name for name in TERMS if name in found) if set(names) <= known else None
