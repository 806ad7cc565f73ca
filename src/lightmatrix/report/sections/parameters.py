"""All parameters of the estimate, enough to repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from lightmatrix.report.elements import Section, Table
from lightmatrix.report.facts import Facts
from lightmatrix.reprs import shown_value

# Longer values, such as lists of one exposure per frame, are cut to this many characters.
_LONGEST = 200


def parameters(facts: Facts) -> Section:
    """The provenance of the estimate."""
    rows = tuple(_flat(facts.transport.provenance))
    lead = "The parameters as the store of the estimate holds them."
    tables = (Table("Parameters", ("parameter", "value"), rows),) if rows else ()
    return Section("parameters", "All parameters", lead, tables)


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{before}{key}".replace("_", " ")
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}: ")
            continue
        text = shown_value(value)
        yield name, text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
