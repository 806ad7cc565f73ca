"""`Errors` of an estimate against the truth, over all rows and over some kinds of rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.evaluation.metrics import (
    diffuse_rows,
    relative_error,
    relighting_error,
    response_rmse,
    row_energies,
    unclipped_rows,
    unseen_patterns,
)
from lightmatrix.files.colours import COLOURS
from lightmatrix.ranges import check_number
from lightmatrix.reprs import html_table, text_table
from lightmatrix.transport.matrix import LightTransport, labelled


@dataclass(frozen=True)
class Errors:
    """The errors of an estimate; those of a kind of rows are NaN if there is no such row.

    Parameters
    ----------
    exposure : float
        Exposure of the capture, which decides which rows clip under one projector pixel.
    relative_error : float
        ||T_est - T||_F / ||T||_F over all rows, background included.
    relighting_error : float
        Relative L2 error of linear, unclipped images, averaged over unseen patterns.
    response_rmse : float
        RMSE of single responses, in units of the clip level.
    share_of_rows_unclipped_responses : float
        Share of the rows that do not clip under a single projector pixel.
    relative_error_unclipped_responses, relighting_error_unclipped_responses : float
        The same errors over these rows.
    share_of_rows_diffuse : float
        Share of the rows whose strongest window of 3 x 3 pixels holds less than half their light.
    relative_error_diffuse, relighting_error_diffuse : float
        The same errors over these rows.

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
        """Names and values, JSON-ready, without those that are NaN."""
        return {name: value for name, value in asdict(self).items() if not math.isnan(value)}

    def __repr__(self) -> str:
        return text_table("Errors", labelled(self.as_dict()))

    def _repr_html_(self) -> str:
        return html_table("Errors", labelled(self.as_dict()))


@dataclass(frozen=True)
class ColourErrors:
    """The errors of the three matrices of a colour projector.

    Parameters
    ----------
    red, green, blue : Errors
        Errors of each primary's matrix.
    relative_error : float
        ||T_est - T||_F / ||T||_F over the three together.
    relighting_error : float
        Relative L2 error of linear, unclipped images under patterns in colour, averaged.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = [lm.ProceduralScene((16, 16), (16, 16)).truth().transport()] * 3
    >>> errors = lm.evaluate_colour(known, known)
    >>> errors.green.relative_error, errors.relighting_error
    (0.0, 0.0)
    """

    red: Errors
    green: Errors
    blue: Errors
    relative_error: float
    relighting_error: float

    def as_dict(self) -> dict[str, Any]:
        """Names and values, JSON-ready, with the errors of each primary under its name."""
        return self._joint | {name: getattr(self, name).as_dict() for name in COLOURS}

    def __repr__(self) -> str:
        return text_table("Errors in colour", labelled(self.table()))

    def _repr_html_(self) -> str:
        return html_table("Errors in colour", labelled(self.table()))

    def table(self) -> dict[str, float]:
        """The two errors that matter most, of the three together and of each."""
        return self._joint | {
            f"{error}_{colour}": getattr(getattr(self, colour), error)
            for colour in COLOURS
            for error in self._joint
        }

    @property
    def _joint(self) -> dict[str, float]:
        return {
            "relative_error": self.relative_error,
            "relighting_error": self.relighting_error,
        }


def errors_in_colour(
    estimates: Sequence[LightTransport], truths: Sequence[LightTransport], exposure: float
) -> ColourErrors:
    """The errors of the matrices of red, green and blue, each and together."""
    each = [errors_by_rows(*pair, exposure) for pair in zip(estimates, truths, strict=True)]
    energies = np.array([float(row_energies(truth).sum()) for truth in truths])
    missed = np.array([one.relative_error for one in each]) ** 2 * energies
    red, green, blue = each
    whole = float(np.sqrt(missed.sum() / energies.sum()))
    return ColourErrors(red, green, blue, whole, joint_relighting_error(estimates, truths))


def joint_relighting_error(
    estimates: Sequence[LightTransport], truths: Sequence[LightTransport]
) -> float:
    """Relative L2 error of linear, unclipped images by matrices whose light adds up.

    It is averaged over unseen patterns. For one matrix it is `relighting_error` under them.
    """
    patterns = np.stack(list(unseen_patterns(truths[0].projector_shape).values()))
    # Each primary shows a different pattern, so that the images have all colours.
    of_primaries = [np.roll(patterns, k, axis=0) for k in range(len(truths))]

    def images(matrices: Sequence[LightTransport]) -> NDArray[np.float64]:
        pairs = zip(matrices, of_primaries, strict=True)
        light = sum(matrix.relight(shown).astype(np.float64) for matrix, shown in pairs)
        return np.reshape(light, (len(patterns), -1))

    predicted, expected = images(estimates), images(truths)
    off = np.linalg.norm(predicted - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return float(off.mean())


def errors_by_rows(estimate: LightTransport, truth: LightTransport, exposure: float) -> Errors:
    """The metrics over all rows, over rows without a clipped single response, and diffuse rows."""
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
        errors = (math.nan, math.nan)
        if len(rows):
            errors = (
                relative_error(estimate, truth, rows),
                relighting_error(estimate, truth, patterns, rows),
            )
        result[f"relative_error_{name}"], result[f"relighting_error_{name}"] = errors
    return Errors(**result)
