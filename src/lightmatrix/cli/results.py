"""What is told about a light transport matrix."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lightmatrix.transport.matrix import LightTransport

# What the keys of the JSON mean, where their words do not say it.
_MEANING = {
    "entries": "entries of T",
    "entries_per_row": "entries a row",
    "background_grid": "blocks of the background",
    "background_share": "light in the background",
    "clipped_samples": "samples that clipped",
    "rows_half_clipped": "rows with half of their samples clipped",
    "iterations_median": "iterations, median of rows",
    "converged_rows": "rows that converged",
    "gap_median": "relative duality gap, median of rows",
    "gap_max": "largest relative duality gap",
    "relative_error": "relative error of T",
    "relighting_error": "relative error of relit images",
    "response_rmse": "RMSE of single responses, of the clip level",
    "share_of_rows_unclipped_responses": "rows that do not clip under one pixel",
    "relative_error_unclipped_responses": "relative error of T in these rows",
    "relighting_error_unclipped_responses": "relative error of relit images in these rows",
    "share_of_rows_diffuse": "diffuse rows",
    "relative_error_diffuse": "relative error of T in diffuse rows",
    "relighting_error_diffuse": "relative error of relit images in diffuse rows",
}
_SHARES = {
    "background_share",
    "clipped_samples",
    "rows_half_clipped",
    "converged_rows",
    "share_of_rows_unclipped_responses",
    "share_of_rows_diffuse",
}


def named(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same by names to read instead of JSON keys, shares in per cent."""
    return {
        _MEANING.get(key, key.replace("_", " ")): f"{100 * value:.1f} %"
        if key in _SHARES
        else value
        for key, value in values.items()
    }


def summary(transport: LightTransport) -> dict[str, Any]:
    """Shapes, sparsity, clipping, convergence and gaps, as names and values."""
    entries = np.diff(transport.sparse.indptr)
    result: dict[str, Any] = {
        "camera": " x ".join(map(str, transport.camera_shape)),
        "projector": " x ".join(map(str, transport.projector_shape)),
        "entries": int(entries.sum()),
        "entries_per_row": float(entries.mean()),
        "background_grid": " x ".join(map(str, transport.background_grid)),
        "background_share": background_share(transport),
    }
    diagnostics = transport.diagnostics
    if "clipped_share" in diagnostics:
        shares = diagnostics["clipped_share"]
        result["clipped_samples"] = float(np.mean(shares))
        result["rows_half_clipped"] = float(np.mean(shares > 0.5))
    if "iterations" in diagnostics:
        result["iterations_median"] = float(np.median(diagnostics["iterations"]))
        result["converged_rows"] = float(np.mean(diagnostics["converged"]))
    if "gap" in diagnostics and np.isfinite(diagnostics["gap"]).any():
        result["gap_median"] = float(np.nanmedian(diagnostics["gap"]))
        result["gap_max"] = float(np.nanmax(diagnostics["gap"]))
    made = transport.provenance
    for name in (
        "estimator",
        "solver",
        "regularization",
        "certificate",
        "pattern_digest",
        "scene",
    ):
        if name in made:
            result[name] = made[name]
    if "solver_parameters" in made and "fidelity" in made["solver_parameters"]:
        result["fidelity"] = made["solver_parameters"]["fidelity"]
    return result


def background_share(transport: LightTransport) -> float:
    """Share of the white image's light that the background holds."""
    # Under white the mean of every block is 1.
    diffuse = float(transport.background.sum(dtype=np.float64))
    total = diffuse + float(transport.sparse.sum())
    return diffuse / total if total else 0.0
