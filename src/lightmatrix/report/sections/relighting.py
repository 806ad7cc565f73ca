"""Under a pattern that was never projected; beside the truth, where it is known."""

from __future__ import annotations

import numpy as np

from lightmatrix.evaluation.metrics import relighting_error, unseen_patterns
from lightmatrix.evaluation.verdict import percent
from lightmatrix.pictures.maps import error_map
from lightmatrix.report.elements import Block, Columns, Gallery, Section, Table, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import difference_image, image_of_map, pattern_image, photograph
from lightmatrix.report.validation import HeldOut
from lightmatrix.reprs import shown_value
from lightmatrix.transport.labels import labelled

_SHOWN = ("disc", "stripes")


def relit(facts: Facts) -> Section:
    """Relit images, and the errors of T where the truth is known."""
    patterns = unseen_patterns(facts.transport.projector_shape)
    blocks: list[Block] = [_images(facts, name, patterns[name]) for name in _SHOWN]
    if facts.truth is None:
        lead = "The scene under patterns that were never projected, not clipped: c = T p."
        if isinstance(facts.held, HeldOut):
            blocks.append(Text("How far such images are right, the photographs held out say."))
    else:
        missed = relighting_error(facts.transport, facts.truth, np.stack(list(patterns.values())))
        lead = (
            "The scene under patterns that were never projected, beside what is true: images are "
            f"off by {percent(missed)} on average over such patterns."
        )
        blocks.append(_against_truth(facts))
    return Section("relit", "Relighting", lead, tuple(blocks))


def _against_truth(facts: Facts) -> Columns:
    assert facts.row_errors is not None
    caption = (
        "Error of each row of T, relative to its own size. Dark rows have little to be relative to."
    )
    shown = Gallery((image_of_map(error_map(facts.row_errors), caption),))
    values = {"relative error of T": facts.relative_error}
    if facts.errors is not None:
        values = labelled(facts.errors.as_dict())
    rows = tuple((name, shown_value(value)) for name, value in values.items())
    return Columns((Table("Errors against the truth", ("what", "value"), rows),), (shown,))


def _images(facts: Facts, name: str, pattern: np.ndarray) -> Gallery:
    image = facts.transport.relight(pattern)
    shown = [pattern_image(pattern, f"The pattern: {name}", f"Pattern: {name}")]
    if facts.truth is None:
        alternative = f"The scene under it ({name}), computed from T"
        shown.append(photograph(image, alternative, "The scene under it", exact=True))
        return Gallery(tuple(shown))
    known = facts.truth.relight(pattern)
    white = float(np.quantile(known, 0.99))
    missed = float(np.linalg.norm(image - known) / max(float(np.linalg.norm(known)), 1e-12))
    shown += [
        photograph(image, f"Computed from T: {name}", "Computed from T", white=white, exact=True),
        photograph(known, f"The truth: {name}", "The truth", white=white, exact=True),
        difference_image(
            image - known,
            0.2 * white,
            f"Difference: {percent(missed)} of the image",
            "Difference",
            f"{percent(missed)} of the image (relative L2)",
        ),
    ]
    return Gallery(tuple(shown))
