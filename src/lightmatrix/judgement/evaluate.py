"""`lm.evaluate`: the errors of an estimate against the truth, over all and some kinds of rows."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS, colour_paths
from lightmatrix.judgement import metrics
from lightmatrix.paths import as_path
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_list, check_number
from lightmatrix.reprs import labelled, text_table
from lightmatrix.simulation import library
from lightmatrix.simulation.realism import is_of_all_primaries, of_primary
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport import store
from lightmatrix.transport.matrix import ColourTransport, LightTransport


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
    """

    red: Errors
    green: Errors
    blue: Errors
    relative_error: float
    relighting_error: float

    def as_dict(self) -> dict[str, Any]:
        """Names and values, JSON-ready, with the errors of each primary under its name."""
        joint = {"relative_error": self.relative_error, "relighting_error": self.relighting_error}
        return joint | {name: getattr(self, name).as_dict() for name in COLOURS}

    def __repr__(self) -> str:
        return text_table("Errors in colour", labelled(self.table()))

    def table(self) -> dict[str, float]:
        """The two errors that matter most, of the three together and of each."""
        names = "relative_error", "relighting_error"
        return {name: getattr(self, name) for name in names} | {
            f"{name}_{colour}": getattr(getattr(self, colour), name)
            for colour in COLOURS
            for name in names
        }


def evaluate(
    estimate: LightTransport | str | Path,
    truth: LightTransport | Truth | str | Path,
    exposure: float = 1.0,
    *,
    progress: Progress | None = None,
) -> Errors:
    """Compare an estimate with the truth.

    Parameters
    ----------
    estimate : LightTransport, str or Path
        The estimate, or where `open` finds it.
    truth : LightTransport, Truth, str or Path
        The known T; a truth file, T.npz; a simulated capture; or a scene, rendered if need be. If
        the estimate is from cropped photographs, only its rows are compared.
    exposure : float
        Exposure of the capture, which decides which rows clip under one projector pixel.
    progress : callable, optional
        Called with (done, total) paths while the scene is rendered.

    Returns
    -------
    Errors
        Relative error, RMSE and relighting error, over all rows and over some kinds of rows.

    Raises
    ------
    InputError
        On matrices of different rigs, unknown scenes, or an exposure out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=20)
    >>> errors = lm.evaluate(estimate, capture.truth, exposure=0.5)
    >>> 0.01 < errors.relative_error < 0.5
    True
    """
    return errors_by_rows(*_matrices(estimate, truth, progress), exposure)


def evaluate_colour(
    estimates: Sequence[LightTransport | str | Path] | ColourTransport | str | Path,
    truths: Sequence[LightTransport | Truth | str | Path] | ColourTransport | Truth | str | Path,
    exposure: float = 1.0,
) -> ColourErrors:
    """Compare the three matrices of a colour projector with the truth.

    Parameters
    ----------
    estimates, truths : sequence of three, ColourTransport, str or Path
        The matrices of red, green and blue, each as `evaluate` takes it; or a folder of three
        stores. Truths may also be the simulated capture of patterns in colour, or its truth.
    exposure : float
        As in `evaluate`.

    Returns
    -------
    ColourErrors
        The errors of each matrix, and of the three together.

    Raises
    ------
    InputError
        As `evaluate`, and on a number of matrices other than three.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((16, 16), 8)
    >>> scene = lm.ProceduralScene((16, 16), (16, 16)).truth()
    >>> captures = [lm.simulate(scene, patterns, primary=name) for name in ("red", "green", "blue")]
    >>> truths = [capture.truth for capture in captures]
    >>> estimates = [truth.transport() for truth in truths]
    >>> lm.evaluate_colour(estimates, truths).relative_error
    0.0
    """
    if isinstance(estimates, str | Path):
        estimates = list(colour_paths(estimates))
    if isinstance(truths, Truth | str | Path):
        # The truths of one capture in colour, or of a folder for each primary.
        folders = [] if isinstance(truths, Truth) else [as_path(truths) / one for one in COLOURS]
        if folders and all(folder.is_dir() for folder in folders):
            truths = folders
        else:
            known = library.truth(truths).transport()
            if known.projector_shape[1] % len(COLOURS) or not is_of_all_primaries(known):
                raise InputError(
                    "a truth that is not of a colour projector",
                    hint="give a capture that `lightmatrix simulate` made of patterns in colour, "
                    "or a folder with the captures red, green and blue",
                )
            truths = [of_primary(known, colour) for colour in COLOURS]
    for matrices, word in ((estimates, "estimates"), (truths, "truths")):
        check_list(matrices, hint="give those of red, green and blue")
        if len(matrices) != 3:
            raise InputError(f"{len(matrices)} {word}", hint="give those of red, green and blue")
    pairs = [_matrices(*pair) for pair in zip(estimates, truths, strict=True)]
    red, green, blue = each = [errors_by_rows(*pair, exposure) for pair in pairs]
    energies = np.array([float(metrics.row_energies(matrix).sum()) for _, matrix in pairs])
    missed = np.array([errors.relative_error for errors in each]) ** 2 * energies
    patterns = np.stack(list(metrics.unseen_patterns(pairs[0][1].projector_shape).values()))
    matrices, expected = zip(*pairs, strict=True)
    relighting = metrics.relighting_error(matrices, expected, patterns)
    relative = float(np.sqrt(missed.sum() / energies.sum()))
    return ColourErrors(red, green, blue, relative, relighting)


def _matrices(
    estimate: LightTransport | str | Path,
    truth: LightTransport | Truth | str | Path,
    progress: Progress | None = None,
) -> tuple[LightTransport, LightTransport]:
    """The matrix of an estimate, and the truth of its rows."""
    matrix = estimate if isinstance(estimate, LightTransport) else store.open(estimate)
    if isinstance(truth, LightTransport):
        known = truth
    else:
        known = library.truth(truth, matrix.projector_shape, progress=progress).transport()
    known = known.cropped_like(matrix)
    if matrix.shape != known.shape:
        names = [
            str(argument) if isinstance(argument, str | Path) else word
            for argument, word in ((estimate, "the estimate"), (truth, "the truth"))
        ]
        raise InputError(
            f"{names[0]} is {matrix.shape[0]} x {matrix.shape[1]}, "
            f"{names[1]} is {known.shape[0]} x {known.shape[1]}",
            hint="compare matrices of one rig with the same binning",
        )
    return matrix, known


def errors_by_rows(estimate: LightTransport, truth: LightTransport, exposure: float) -> Errors:
    """The metrics over all rows, over rows without a clipped single response, and diffuse rows."""
    check_number("an exposure", exposure, above=True, hint="use a number above 0, such as 1")
    patterns = np.stack(list(metrics.unseen_patterns(truth.projector_shape).values()))
    result = {
        "exposure": float(exposure),
        "relative_error": metrics.relative_error(estimate, truth),
        "relighting_error": metrics.relighting_error([estimate], [truth], patterns),
        "response_rmse": metrics.response_rmse(estimate, truth, clip_level=1 / exposure),
    }
    groups = {
        "unclipped_responses": metrics.unclipped_rows(truth, exposure),
        "diffuse": metrics.diffuse_rows(truth.sparse, truth.projector_shape),
    }
    for name, chosen in groups.items():
        rows = np.flatnonzero(chosen)
        result[f"share_of_rows_{name}"] = float(chosen.mean())
        errors = (math.nan, math.nan)
        if len(rows):
            errors = (
                metrics.relative_error(estimate, truth, rows),
                metrics.relighting_error([estimate], [truth], patterns, rows),
            )
        result[f"relative_error_{name}"], result[f"relighting_error_{name}"] = errors
    return Errors(**result)
