"""What is told about a light transport matrix and its errors, in words instead of keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightmatrix.files.colours import COLOURS

# What the keys of the JSON mean, where their words do not say it.
_MEANING = {
    "entries": "entries of T",
    "entries_per_row": "entries a row",
    "background_grid": "cells of the background",
    "background_share": "light in the background",
    "clipped_samples": "samples that clipped",
    "rows_half_clipped": "rows with half of their samples clipped",
    "iterations_median": "iterations, median of rows",
    "converged_rows": "rows that converged",
    "gap_median": "relative duality gap, median of rows",
    "gap_max": "largest relative duality gap",
    "rows_looked_everywhere": "rows that looked at every projector pixel",
    "rows_that_hold_everywhere": "rows, of a sample, certified against every projector pixel",
    "relative_error": "relative error of T",
    "relighting_error": "relative error of relit images",
    "response_rmse": "RMSE of single responses, of the clip level",
    "share_of_rows_unclipped_responses": "rows that do not clip under one pixel",
    "relative_error_unclipped_responses": "relative error of T in these rows",
    "relighting_error_unclipped_responses": "relative error of relit images in these rows",
    "share_of_rows_diffuse": "diffuse rows",
    "relative_error_diffuse": "relative error of T in diffuse rows",
    "relighting_error_diffuse": "relative error of relit images in diffuse rows",
} | {
    f"{error}_{colour}": f"{colour}: {words}"
    for error, words in (
        ("relative_error", "relative error of T"),
        ("relighting_error", "relative error of relit images"),
    )
    for colour in COLOURS
}
_SHARES = {
    "background_share",
    "clipped_samples",
    "rows_half_clipped",
    "converged_rows",
    "rows_looked_everywhere",
    "rows_that_hold_everywhere",
    "share_of_rows_unclipped_responses",
    "share_of_rows_diffuse",
}


def labelled(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same by names to read instead of JSON keys, shares in per cent."""
    return {
        _MEANING.get(key, key.replace("_", " ")): f"{100 * value:.1f} %"
        if key in _SHARES
        else value
        for key, value in values.items()
    }
