"""The table of faults, by subject."""

from __future__ import annotations

from ..case import Case
from . import (
    archives,
    arguments,
    captures,
    damaged_images,
    descriptions,
    foreign,
    geometry,
    images,
    misread,
    outputs,
    partial,
    resources,
    stores,
    streams,
    together,
    uses,
    views,
)

_MODULES = (
    *(outputs, foreign, arguments, descriptions, captures, images, damaged_images, stores),
    *(archives, partial, together, streams, resources, views, geometry, uses),
    misread,
)


def _grouped() -> dict[str, dict[str, Case]]:
    groups: dict[str, dict[str, Case]] = {}
    for module in _MODULES:
        group = module.__name__.rpartition(".")[2]
        named = {f"{group}: {case.name}": case for case in module.CASES}
        if len(named) != len(module.CASES):
            twice = [case.name for case in module.CASES]
            raise ValueError(
                f"two cases of one name: {sorted({n for n in twice if twice.count(n) > 1})}"
            )
        groups[group] = named
    return groups


# What the cases of each subject need of the work folder.
NEEDS: dict[str, tuple[str, ...]] = {
    module.__name__.rpartition(".")[2]: module.NEEDS for module in _MODULES
}
# Subject -> name of a case -> the case.
GROUPS = _grouped()
ALL = {name: case for cases in GROUPS.values() for name, case in cases.items()}


def group_of(name: str) -> str:
    """The subject of a case."""
    return name.partition(": ")[0]
