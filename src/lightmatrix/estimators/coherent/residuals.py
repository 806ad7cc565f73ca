"""What the residuals of some rows say of the light that T cannot explain.

Photographs held out of an estimate do not show what is wrong with all photographs alike. Two such
faults leave traces in the residuals. A constant light, as of an electronic pedestal, of the room or
of a projector whose black is not dark, is taken for a background, but does not get brighter with
the patterns. And where samples are no linear function of light, residuals bend with the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.camera.samples import Samples
from lightmatrix.estimators.coherent.correspondence import strongest_entries
from lightmatrix.estimators.coherent.row_solver import RowSolver, WeightedRows
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.solvers.problem import Result

# The most rows, evenly spread, whose residuals are looked at. Chosen by hand: what is wrong in all
# rows shows in these as well, and they cost little.
MOST_ROWS = 4096
# Patterns are alike in brightness if their means vary by less than this share of it. Chosen by
# hand: the means of random patterns of 128 x 128 pixels vary by 0.8 %.
_ALIKE = 0.004
# Rows that are only bounded and clip in more than this share of K photographs, and 1.5 / K more,
# see a glint: several projector pixels clip them alone. Rows of intact captures reach .69, glints
# 30 to 100 times as bright as the rest clip in .77 to 1. Chosen on 180 small captures.
_MOSTLY, _FEW = 0.72, 1.5
# Fewer samples of a row that do not clip show no curve.
_FEWEST = 8


@dataclass(frozen=True, eq=False)
class Predicted:
    """The predicted samples of m rows under K patterns: of their atoms and of their background.

    Parameters
    ----------
    atoms, background : (m, K)
        Light in units of camera sample.
    brightness : (K,)
        Mean of each pattern.
    """

    atoms: NDArray[np.float32]
    background: NDArray[np.float32]
    brightness: NDArray[np.float64]


def predicted_samples(
    solver: RowSolver, weighted: WeightedRows, solved: Result, index: NDArray[np.int64]
) -> Predicted:
    """The predicted samples of some of the solved rows under the patterns shown."""
    patterns, brightness = solver.capture.patterns, solver.backgrounds.brightness
    if not len(index):
        nothing = np.zeros((0, patterns.count), np.float32)
        return Predicted(nothing, nothing, brightness)
    pixels = solver.atoms.expand(csr_array(solved.coefficients[index], dtype=np.float32))
    used, place = np.unique(pixels.indices, return_inverse=True)
    own = csr_array((pixels.data, place, pixels.indptr), shape=(len(index), len(used)))
    light: NDArray[Any] = (
        solved.background[index][:, None] * weighted.background[index, : patterns.count]
    )
    if solved.cells.shape[1]:
        light = light + solved.cells[index] @ solver.backgrounds.shown_means
    return Predicted(
        np.asarray(own @ patterns.columns(used).T, np.float32).reshape(light.shape),
        np.asarray(light, np.float32),
        brightness,
    )


def residual_diagnostics(
    solver: RowSolver,
    weighted: WeightedRows,
    solved: Result,
    pixels: csr_array,
    chosen: NDArray[np.int64],
) -> dict[str, NDArray[Any]]:
    """The diagnostics of solved rows that their samples and residuals give.

    `pixels` are the rows as pixels. `only_bounded` and `glint` are of all rows, `constant_light`
    and `bend` are of the `chosen` ones, and NaN of others.
    """
    samples = weighted.problem.samples
    shown, few = predicted_samples(solver, weighted, solved, chosen), samples.rows(chosen)
    constant, bent = (np.full(len(samples.values), np.nan) for _ in range(2))
    constant[chosen], bent[chosen] = constant_light(few, shown), bend(few, shown)
    bounded = only_bounded(samples, pixels, solver.capture.patterns)
    clipped = samples.clipped.mean(axis=1)
    return {
        "only_bounded": bounded,
        "glint": bounded & (clipped > _MOSTLY + _FEW / samples.clipped.shape[1]),
        "constant_light": constant,
        "bend": bent,
    }


def squared_residual(samples: Samples, predicted: Predicted) -> NDArray[np.float32]:
    """Mean squared residual of rows at their samples that count and do not clip, (m,)."""
    counted = samples.counted & ~samples.clipped
    left = (samples.values - predicted.atoms - predicted.background) * counted
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((left**2).sum(axis=1) / counted.sum(axis=1), np.float32)


def constant_light(samples: Samples, predicted: Predicted) -> NDArray[np.float64]:
    """The share of each row's mean sample that does not follow the brightness of patterns, (m,).

    A background that is constant in truth is predicted to vary with the patterns. This leaves
    residuals in proportion, beside those that the atoms can explain. NaN for rows that show
    nothing.
    """
    counted = samples.counted & ~samples.clipped
    background = predicted.background.astype(np.float64)
    left = _centred(samples.values - predicted.atoms - background, counted)
    direct = _centred(predicted.atoms, counted)
    mean = predicted.brightness.mean()
    # One unit of the background at mean brightness.
    level = background.mean(axis=1, keepdims=True)
    if predicted.brightness.std() > _ALIKE * mean:
        shape = np.broadcast_to(predicted.brightness / mean, background.shape)
    else:
        shape = background / np.where(level > 0, level, np.nan)
    unit = _without(_centred(shape, counted), direct)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = (left * unit).sum(axis=1) / (unit**2).sum(axis=1)
        mean = (samples.values * samples.counted).sum(axis=1) / samples.counted.sum(axis=1)
        # No more was taken for a background than there is.
        most = level.ravel() / mean
        return np.where(level.ravel() > 0, np.clip(-slope / mean, -most, most), 0 * mean)


def bend(samples: Samples, predicted: Predicted) -> NDArray[np.float64]:
    """How far residuals bend with the prediction, relative to the row's contrast, (m,).

    Below 0 where bright samples are darker than predicted, as through a gamma curve or beyond an
    unknown clip level. NaN for rows that show nothing.
    """
    counted = samples.counted & ~samples.clipped
    whole = predicted.atoms.astype(np.float64) + predicted.background
    left = _centred(samples.values - whole, counted)
    linear = _centred(whole, counted)
    square = _without(_centred(linear**2, counted), linear)
    contrast = np.sqrt((_centred(samples.values, counted) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (left * square).sum(axis=1) / np.sqrt((square**2).sum(axis=1))
        return np.where(counted.sum(axis=1) >= _FEWEST, along / contrast, np.nan)


def only_bounded(samples: Samples, pixels: csr_array, patterns: PatternSet) -> NDArray[np.bool_]:
    """Whether rows clip in every photograph that shows their strongest projector pixel, (m,).

    Its light has a lower bound only, however well the other photographs are predicted.
    """
    entries = np.diff(pixels.indptr)
    lit = np.flatnonzero(entries)
    bounded = np.zeros(len(entries), bool)
    if not len(lit):
        return bounded
    strongest = strongest_entries(pixels)[lit]
    used, place = np.unique(strongest, return_inverse=True)
    shown = patterns.columns(used).T
    shown = (shown >= shown.max(axis=1, keepdims=True) / 2)[place]
    some = samples.rows(lit)
    seen = (shown & some.counted & ~some.clipped).any(axis=1)
    bounded[lit] = ~seen & (shown & some.counted & some.clipped).any(axis=1)
    return bounded


def _centred(values: NDArray[np.floating], counted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Values less their means over the samples that count, 0 elsewhere."""
    number = np.maximum(counted.sum(axis=1, keepdims=True), 1)
    mean = (values * counted).sum(axis=1, keepdims=True, dtype=np.float64) / number
    return np.asarray((values - mean) * counted)


def _without(values: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows less the part along other rows."""
    length = np.maximum((other**2).sum(axis=1, keepdims=True), 1e-30)
    return np.asarray(values - other * (values * other).sum(axis=1, keepdims=True) / length)
