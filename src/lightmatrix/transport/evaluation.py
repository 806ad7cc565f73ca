"""How far an estimate is from the truth, over all rows and over some kinds of rows."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from lightmatrix.ranges import check_number
from lightmatrix.reprs import html_table, text_table
from lightmatrix.transport.labels import named
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.metrics import (
    diffuse_rows,
    relative_error,
    relighting_error,
    response_rmse,
    unclipped_rows,
    unseen_patterns,
)


@dataclass(frozen=True)
class Errors:
    """The errors of an estimate; those of a kind of rows are NaN where there is no such row.

    Parameters
    ----------
    exposure : float
        Exposure of the capture, which tells the rows that clip under one projector pixel.
    relative_error : float
        ||T_est - T||_F / ||T||_F over all rows, background included.
    relighting_error : float
        Relative L2 error of linear, unclipped images, averaged over patterns that no estimate saw.
    response_rmse : float
        RMSE of single responses, in units of the clip level.
    share_of_rows_unclipped_responses, share_of_rows_diffuse : float
        Share of the rows that do not clip under a single projector pixel; whose strongest window
        of 3 x 3 pixels holds less than half of their light.
    relative_error_unclipped_responses, relighting_error_unclipped_responses : float
        The same errors over the rows that do not clip under a single projector pixel.
    relative_error_diffuse, relighting_error_diffuse : float
        The same errors over diffuse rows.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> lm.evaluate(known.transport(), known).relative_error
    0.0
    """

    exposure: float
    relative_error: float
    relighting_error: float
    response_rmse: float
    share_of_rows_unclipped_responses: float
    relative_error_unclipped_responses: float
    relighting_error_unclipped_responses: float
    share_of_rows_diffuse: float
    relative_error_diffuse: float
    relighting_error_diffuse: float

    def as_dict(self) -> dict[str, float]:
        """Names and values, JSON-ready; without those that no row has."""
        return {name: value for name, value in asdict(self).items() if not math.isnan(value)}

    def __repr__(self) -> str:
        return text_table("Errors", named(self.as_dict()))

    def _repr_html_(self) -> str:
        return html_table("Errors", named(self.as_dict()))


def errors_by_rows(estimate: LightTransport, truth: LightTransport, exposure: float) -> Errors:
    """The project's metrics over all rows, rows that do not clip singly, and diffuse rows.

    Parameters
    ----------
    exposure : float
        Exposure of the capture, > 0.

    Raises
    ------
    InputError
        On matrices of different rigs, or an exposure out of range.
    """
    check_number("an exposure", exposure, above=True, hint="use a number above 0, such as 1")
    patterns = np.stack(list(unseen_patterns(truth.projector_shape).values()))
    result = {
        "exposure": float(exposure),
        "relative_error": relative_error(estimate, truth),
        "relighting_error": relighting_error(estimate, truth, patterns),
        "response_rmse": response_rmse(estimate, truth, clip_level=1 / exposure),
    }
    groups = {
        "unclipped_responses": unclipped_rows(truth, exposure),
        "diffuse": diffuse_rows(truth.sparse, truth.projector_shape),
    }
    for name, chosen in groups.items():
        rows = np.flatnonzero(chosen)
        result[f"share_of_rows_{name}"] = float(chosen.mean())
        found = len(rows) > 0
        result[f"relative_error_{name}"] = (
            relative_error(estimate, truth, rows) if found else math.nan
        )
        result[f"relighting_error_{name}"] = (
            relighting_error(estimate, truth, patterns, rows) if found else math.nan
        )
    return Errors(**result)
