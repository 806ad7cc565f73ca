"""How accurate the estimate is: its summary, duality gaps, estimated errors, unseen photographs."""

from __future__ import annotations

from lightmatrix.evaluation.judgement import percent
from lightmatrix.pictures.maps import Map, estimated_error_map, gap_map, has_diagnostic
from lightmatrix.report.elements import Columns, Element, Gallery, Image, Section, Table, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import difference_image, image_of_map, pattern_image, photograph
from lightmatrix.report.validation import Validation
from lightmatrix.reprs import shown_value
from lightmatrix.transport.matrix import labelled

# The page shows this many of the unseen photographs.
_COMPARED = 2
# The scale of a difference does not end below this share of the clip level, three times the usual
# noise, so that noise does not look like an error. Chosen by eye.
_SMALLEST_SCALE = 0.01


def error_estimates(facts: Facts) -> Section:
    """The summary of the estimate, maps of its errors, and predictions beside photographs."""
    summary = labelled(facts.transport.summary())
    rows = tuple((name, shown_value(value)) for name, value in summary.items())
    table = Table("The estimate", ("property", "value"), rows)
    maps = tuple(image_of_map(shown, caption) for shown, caption in _maps(facts))
    elements = [Columns((table,), (Gallery(maps),) if maps else ()), *_unseen_photographs(facts)]
    lead = (
        "A duality gap certifies that the solver solved its problem. Whether the solution is what "
        "the camera sees, only unseen photographs can show."
    )
    return Section("accuracy", "Accuracy of the estimate", lead, tuple(elements))


def _maps(facts: Facts) -> list[tuple[Map, str]]:
    maps = []
    if has_diagnostic(facts.transport, "estimated_error"):
        caption = "Each camera pixel's own estimate, from its samples and its neighbours."
        maps.append((estimated_error_map(facts.transport), caption))
    if has_diagnostic(facts.transport, "gap"):
        caption = (
            "How far the objective of each row can be from its optimum. A small gap means solved, "
            "not necessarily right."
        )
        maps.append((gap_map(facts.transport), caption))
    return maps


def _unseen_photographs(facts: Facts) -> list[Element]:
    validation = facts.validation
    if not isinstance(validation, Validation):
        return [Text(f"The estimate was not tested on unseen photographs: {validation}.")]
    where = ""
    if validation.region is not None:
        rows, cols = validation.region
        where = (
            " The camera is large, so only its rows "
            f"{rows.start} to {rows.stop - 1} and columns {cols.start} to {cols.stop - 1} were "
            "tested."
        )
    count = min(_COMPARED, len(validation.frames))
    return [
        Text(
            f"Prediction error on unseen photographs: {percent(validation.error)}. For comparison: "
            f"the mean of the other photographs, which ignores the pattern, misses them by "
            f"{percent(validation.mean_error)}."
        ),
        Text(
            f"{_named(validation)} left out, T was estimated again from the other "
            f"{validation.others}, and each of the unseen photographs was predicted from its "
            "pattern. The error is relative; samples that clip in both images are left out. The "
            "second estimate has fewer photographs, so it is a little worse than the one that this "
            f"report describes.{where}"
        ),
        *(Gallery(_comparison(facts, validation, k)) for k in range(count)),
    ]


def _comparison(facts: Facts, validation: Validation, index: int) -> tuple[Image, ...]:
    number = int(validation.frames[index])
    pattern = facts.capture.patterns.images(number, number + 1)[0]
    difference = validation.difference[index]
    mean = float(abs(difference).mean())
    return (
        pattern_image(pattern, f"Pattern {number}", f"Pattern {number}"),
        photograph(
            validation.photographs[index],
            f"Photograph {number}",
            f"Photograph {number}",
            "White is the clip level.",
            white=1.0,
            exact=True,
        ),
        photograph(
            validation.predictions[index],
            f"Prediction of photograph {number}",
            "Its prediction",
            "From an estimate that has not seen the photograph.",
            white=1.0,
            exact=True,
        ),
        difference_image(
            difference,
            _SMALLEST_SCALE,
            f"Difference: {percent(mean)} of the clip level on average",
            "Prediction minus photograph",
            "Grey where they agree.",
        ),
    )


def _named(validation: Validation) -> str:
    numbers = [str(k) for k in validation.frames]
    if len(numbers) == 1:
        return f"Photograph {numbers[0]} was"
    return f"Photographs {', '.join(numbers[:-1])} and {numbers[-1]} were"
