"""The scene relit by patterns that were never projected, beside the truth where it is known."""

from __future__ import annotations

import numpy as np

from lightmatrix.evaluation.judgement import percent
from lightmatrix.evaluation.metrics import relighting_error, unseen_patterns
from lightmatrix.pictures.maps import error_map
from lightmatrix.report.elements import Columns, Element, Gallery, Section, Table, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import difference_image, image_of_map, pattern_image, photograph
from lightmatrix.report.validation import Validation
from lightmatrix.reprs import shown_value
from lightmatrix.transport.matrix import labelled

_SHOWN = ("disc", "stripes")
# White is this quantile of the true image, and the scale of its difference does not end below this
# share of white. Chosen by eye.
_WHITE_QUANTILE, _SMALLEST_SCALE = 0.99, 0.01


def relighting(facts: Facts) -> Section:
    """Relit images, and the errors of T where the truth is known."""
    patterns = unseen_patterns(facts.transport.projector_shape)
    elements: list[Element] = [_images(facts, name, patterns[name]) for name in _SHOWN]
    lead = "The scene under patterns that were never projected, without clipping: c = T p."
    if facts.truth is None:
        if isinstance(facts.validation, Validation):
            expected = percent(facts.validation.error)
            elements.append(Text(f"Expect errors as on unseen photographs: {expected}."))
    else:
        error = relighting_error(facts.transport, facts.truth, np.stack(list(patterns.values())))
        lead += f" Mean error of the images: {percent(error)}."
        elements.append(_against_truth(facts))
    return Section("relighting", "Relighting", lead, tuple(elements))


def _against_truth(facts: Facts) -> Columns:
    assert facts.row_errors is not None
    caption = "Error of each camera pixel's rows of T, relative to their size."
    errors = Gallery((image_of_map(error_map(facts.row_errors), caption),))
    values = {"relative error of T": facts.relative_error}
    if facts.errors is not None:
        values = labelled(facts.errors.as_dict())
    rows = tuple((name, shown_value(value)) for name, value in values.items())
    return Columns((Table("Errors against the truth", ("error", "value"), rows),), (errors,))


def _images(facts: Facts, name: str, pattern: np.ndarray) -> Gallery:
    image = facts.transport.relight(pattern)
    images = [pattern_image(pattern, f"The pattern: {name}", f"Pattern: {name}")]
    if facts.truth is None:
        alternative = f"The relit scene ({name}), computed from T"
        images.append(photograph(image, alternative, "The relit scene", exact=True))
        return Gallery(tuple(images))
    known = facts.truth.relight(pattern)
    white = float(np.quantile(known, _WHITE_QUANTILE))
    error = float(np.linalg.norm(image - known) / max(float(np.linalg.norm(known)), 1e-12))
    images += [
        photograph(image, f"Computed from T: {name}", "Computed from T", white=white, exact=True),
        photograph(known, f"The truth: {name}", "The truth", white=white, exact=True),
        difference_image(
            image - known,
            _SMALLEST_SCALE * white,
            f"Difference: {percent(error)} of the image",
            "Difference",
            f"Relative error of the image: {percent(error)}.",
        ),
    ]
    return Gallery(tuple(images))
