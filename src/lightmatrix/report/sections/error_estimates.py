"""How well it was solved: certificates, what the rows state of themselves, photographs held out."""

from __future__ import annotations

from lightmatrix.evaluation.verdict import percent
from lightmatrix.pictures.maps import Map, gap_map, has_diagnostic, stated_error_map
from lightmatrix.report.elements import Block, Columns, Gallery, Image, Section, Table, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import difference_image, image_of_map, pattern_image, photograph
from lightmatrix.report.validation import HeldOut
from lightmatrix.reprs import shown_value
from lightmatrix.transport.labels import labelled

# Of the photographs held out, so many are shown.
_COMPARED = 2


def solved(facts: Facts) -> Section:
    """Numbers and maps of the rows, then predictions beside photographs."""
    summary = facts.transport.summary()
    table = Table(
        "The estimate",
        ("what", "value"),
        tuple((name, shown_value(value)) for name, value in labelled(summary).items()),
    )
    maps = tuple(image_of_map(shown, caption) for shown, caption in _maps(facts))
    blocks: list[Block] = [Columns((table,), (Gallery(maps),) if maps else ())]
    blocks += _held_out(facts)
    lead = "A solver's certificate says that its problem was solved; whether its solution is what "
    lead += "the camera sees, only photographs that it has not seen can say."
    return Section("solved", "How well it was solved", lead, tuple(blocks))


def _maps(facts: Facts) -> list[tuple[Map, str]]:
    found = []
    if has_diagnostic(facts.transport, "estimated_error"):
        caption = "What each row thinks of itself, from its own samples and its neighbours."
        found.append((stated_error_map(facts.transport), caption))
    if has_diagnostic(facts.transport, "gap"):
        caption = (
            "How far the objective of each row can be from its optimum. Small is solved, not "
            "necessarily right."
        )
        found.append((gap_map(facts.transport), caption))
    return found


def _held_out(facts: Facts) -> list[Block]:
    held = facts.held
    if not isinstance(held, HeldOut):
        return [Text(f"No photograph was held out: {held}.")]
    where = ""
    if held.place is not None:
        rows, cols = held.place
        where = (
            f" The camera is large, so this was done on its rows {rows.start} to {rows.stop - 1} "
            f"and columns {cols.start} to {cols.stop - 1} alone."
        )
    return [
        Text(
            f"{_numbered(held)} held out, T was estimated once more from the other "
            f"{held.others}, and their patterns were put into it. With fewer photographs this "
            "second estimate is a little worse than the one that the report is about."
            f" It misses them by {percent(held.error)} (relative, samples that clip in both left "
            f"out); the mean of the others, which knows nothing of T, misses by "
            f"{percent(held.trivial_error)}.{where}"
        ),
        *(Gallery(_compared(facts, held, k)) for k in range(min(_COMPARED, len(held.frames)))),
    ]


def _compared(facts: Facts, held: HeldOut, index: int) -> tuple[Image, ...]:
    number = int(held.frames[index])
    pattern = facts.capture.patterns.images(number, number + 1)[0]
    taken, guessed = held.photographed[index], held.predicted[index]
    difference = held.difference[index]
    most = max(0.05, 5 * float(abs(difference).mean()))
    return (
        pattern_image(pattern, f"Pattern {number}", f"Pattern {number}"),
        photograph(
            taken, f"Photograph {number}", f"Photograph {number}", "as taken, clip level white",
            white=1.0, exact=True,
        ),
        photograph(
            guessed, f"Prediction of photograph {number}", "Its prediction", "by an estimate that "
            "has not seen it", white=1.0, exact=True,
        ),
        difference_image(
            difference, most,
            f"Difference: {percent(float(abs(difference).mean()))} of the clip level on average",
            "Prediction minus photograph", "grey where they agree",
        ),
    )  # fmt: skip


def _numbered(held: HeldOut) -> str:
    numbers = [str(k) for k in held.frames]
    if len(numbers) == 1:
        return f"Photograph {numbers[0]} was"
    return f"Photographs {', '.join(numbers[:-1])} and {numbers[-1]} were"
