"""Labels for the numbers of a light transport matrix and of its errors, in place of JSON keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightmatrix.files.colours import COLOURS

# Keys that need more than spaces for their underscores. A label has at most 26 characters, which
# leaves room for its value on a terminal of 80 columns.
_LABELS = {
    "entries_per_row": "entries per row",
    "background_grid": "background cells",
    "background_share": "light in the background",
    "rows_half_clipped": "rows half clipped or more",
    "iterations_median": "iterations (median)",
    "gap_median": "duality gap (median)",
    "gap_max": "duality gap (largest)",
    "rows_searched_everywhere": "rows searched everywhere",
    "rows_certified_everywhere": "rows certified everywhere",
    "relative_error": "error of T",
    "relighting_error": "error of relit images",
    "response_rmse": "RMSE of single responses",
    "share_of_rows_unclipped_responses": "rows no single pixel clips",
    "relative_error_unclipped_responses": "error of T, these rows",
    "relighting_error_unclipped_responses": "relit images, these rows",
    "share_of_rows_diffuse": "diffuse rows",
    "relative_error_diffuse": "error of T, diffuse rows",
    "relighting_error_diffuse": "relit images, diffuse rows",
} | {
    f"{error}_{colour}": f"{colour}: {label}"
    for error, label in (
        ("relative_error", "error of T"),
        ("relighting_error", "relit images"),
    )
    for colour in COLOURS
}
# Values between 0 and 1 that are shown in per cent.
_SHARES = {
    "background_share",
    "clipped_samples",
    "rows_half_clipped",
    "converged_rows",
    "rows_searched_everywhere",
    "rows_certified_everywhere",
    "share_of_rows_unclipped_responses",
    "share_of_rows_diffuse",
}
# What a user wants to know of an estimate at first sight, besides the verdict.
_MAIN = (
    "camera",
    "crop",
    "projector",
    "entries_per_row",
    "background_share",
    "clipped_samples",
    "converged_rows",
    "gap_max",
    "estimator",
    "regularization",
)


def labelled(values: Mapping[str, Any], *, main_only: bool = False) -> dict[str, Any]:
    """The values with labels for keys and shares in per cent; about ten lines if `main_only`."""
    keys = [key for key in _MAIN if key in values] if main_only else list(values)
    return {
        _LABELS.get(key, key.replace("_", " ")): f"{100 * values[key]:.1f} %"
        if key in _SHARES
        else values[key]
        for key in keys
    }
