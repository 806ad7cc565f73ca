"""How far to trust each row: by frames held out, by its residuals, and against all atoms.

**Held-out frames.** A row solved without some of its frames mispredicts these by what it has wrong.
Under random patterns an error d of the row gives an error of the sample whose variance is that of
the patterns' values times ||d||^2. So the frames held out measure ||d|| itself, of a row from a few
frames less. Where patterns are smooth, light that is taken for a neighbour's hardly shows, and only
the contrast between neighbours counts. A photograph of a pattern that was shown twice, or whose
inverse was shown, follows from the others whatever T is. Such frames are held out together. If that
leaves too few others, nothing is tested.

**Residuals.** Photographs held out do not show what is wrong with all photographs alike. Two such
faults leave traces in the residuals of some rows. A constant light, as of an electronic pedestal,
of the room or of a projector whose black is not dark, is taken for a background, but does not get
brighter with the patterns. And where samples are no linear function of light, residuals bend with
the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.capture.samples import Samples
from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE
from lightmatrix.estimators.coherent.neighbourhood import mean_around, strongest_entries
from lightmatrix.estimators.coherent.row_solver import RowSolver
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import is_separable
from lightmatrix.solvers.problem import Result

# No frame is held out of fewer.
FEWEST = 8


def held_out_frames(count: int) -> NDArray[np.int64]:
    """One frame of eight, evenly spread, but four of fewer than 16; none of fewer than `FEWEST`."""
    # Chosen by hand: the row should lose few frames, and few frames have a vague variance.
    if count < FEWEST:
        return np.zeros(0, np.int64)
    held = count // 8 if count >= FEWEST_BLACK_AND_WHITE else 4
    return ((np.arange(held) + 0.5) * count / held).astype(np.int64)


def without(samples: Samples, held: NDArray[np.int64]) -> Samples:
    """The samples with those of the frames held out masked."""
    weights = samples.weights_of_all()
    weights[:, held] = 0
    return Samples(samples.values, samples.clipped, samples.clip_level, weights)


def squared_misfit(
    samples: Samples, predicted: NDArray[np.float32], held: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Variance of each row's misfit at the H frames `held`, (M,); NaN where fewer than 2 count."""
    off = samples.values[:, held] - predicted
    weights = samples.weights_of_all()[:, held]
    # A clipped sample that is predicted beyond its bound says nothing about the error.
    weights[samples.clipped[:, held] & (off <= 0)] = 0
    total = weights.sum(axis=1)
    # The mean misfit is the error of the background and does not count. `number` is the effective
    # number of samples.
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (weights * off).sum(axis=1) / total
        number = total**2 / (weights**2).sum(axis=1)
        spread = (weights * (off - mean[:, None]) ** 2).sum(axis=1) / total
        spread *= number / np.maximum(number - 1, 0.5)
    # One sample is its own mean. Its number may differ from 1 by rounding.
    return np.where(number > 1.001, spread, np.nan).astype(np.float32)


def noise_of(residuals: NDArray[np.float32]) -> float:
    """The variance of the camera's noise by the residuals of some rows; those not known are NaN."""
    known = residuals[np.isfinite(residuals)]
    # It is at most this quantile of the misfits under the frames that rows were solved with: most
    # rows explain these but for noise. Chosen on 100 small captures (benchmarks/honesty.py).
    return float(np.quantile(known, 0.25)) if len(known) else 0.0


def held_out_energy(
    samples: Samples, predicted: NDArray[np.float32], held: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean squares of each row's misses at the frames `held`, and of its samples there, (M,)."""
    values = samples.values[:, held]
    off = values - predicted
    weights = (samples.weights_of_all()[:, held] > 0).astype(np.float32)
    # Samples that clip, and are predicted beyond their bound, are right.
    off[samples.clipped[:, held] & (off <= 0)] = 0
    total = np.maximum(weights.sum(axis=1), 1)
    return (weights * off**2).sum(axis=1) / total, (weights * values**2).sum(axis=1) / total


def smooth_misfit(
    squares: NDArray[np.float32], camera: tuple[int, int, int], noise: float, spacing: int = 1
) -> NDArray[np.float32]:
    """Misfits averaged over neighbouring camera pixels, less the camera's noise, (M,).

    They are known at every `spacing`-th camera pixel at most.
    """
    image = squares.reshape(camera).astype(np.float64)
    known = np.isfinite(image)
    means = np.full(camera, np.nan)
    if not known.any():
        return np.asarray(means.ravel(), np.float32)
    # Errors are smooth over the camera. Squares of three pixels a side suffice where every pixel or
    # every second one is known, and in proportion where fewer are. A wider square stands in where a
    # narrower one knows nothing.
    for width in (3, 9, 27):
        missing = ~np.isfinite(means)
        if missing.any():
            side = 1 + (width - 1) * max(1, spacing // 2)
            means[missing] = mean_around(image, known, side)[missing]
    # At least a tenth of a misfit counts as error. Chosen on 100 small captures.
    return np.asarray(np.maximum(means - noise, 0.1 * means).ravel(), np.float32)


# Frames are compared with all others. If there are more than this, only about so many are compared
# that are most like those to hold out, which bounds the time to a few seconds.
_COMPARED = 1024
# Contrasts below this share of the largest one are rounding.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The frames that are held out, and those among them by which the error is judged.

    A frame that repeats or inverts a judged one is held out with it; it adds no knowledge.
    """

    frames: NDArray[np.int64]
    judged: NDArray[np.int64]

    def together(self, count: int) -> list[tuple[NDArray[np.int64], slice]]:
        """Frames that are held out together, and the places of their judged ones in `judged`.

        Of fewer than 16 frames in all, one is held out at a time: each is needed.
        """
        if count >= FEWEST_BLACK_AND_WHITE or len(self.frames) != len(self.judged):
            return [(self.frames, slice(None))]
        return [(self.judged[[k]], slice(k, k + 1)) for k in range(len(self.judged))]

    @classmethod
    def choose(cls, patterns: PatternSet, judged: int | None = None) -> HeldOut:
        """The frames to hold out of some patterns; none if they could test nothing.

        About every eighth frame is judged, or as few as `judged`, which is at least 2.
        """
        nothing = np.zeros(0, np.int64)
        usual = held_out_frames(patterns.count)
        # A code of stripes needs each of its bits, so nothing can be held out.
        if not len(usual) or is_separable(patterns):
            return cls(nothing, nothing)
        if judged is not None and judged < len(usual):
            usual = usual[np.linspace(0, len(usual) - 1, judged).astype(int)]
        # The patterns, each less its mean, at some pixels, (K, n).
        most = max(4096, 4 * patterns.count)
        pixels = np.sort(np.random.default_rng(0).permutation(patterns.pixels)[:most])
        values = patterns.columns(pixels).astype(np.float64)
        values -= values.mean(axis=1, keepdims=True)
        compared = np.arange(len(values))
        if len(values) > _COMPARED:
            spread = np.linalg.norm(values, axis=1)
            lengths = np.maximum(spread[:, None] * spread[usual], 1e-300)
            cosines, each = np.abs(values @ values[usual].T) / lengths, _COMPARED // len(usual)
            nearest = np.argpartition(-cosines, each, axis=0)[:each]
            compared = np.union1d(nearest.ravel(), usual)
        chosen = cls._among(values[compared], np.searchsorted(compared, usual))
        return cls(compared[chosen.frames], compared[chosen.judged])

    @classmethod
    def _among(cls, values: NDArray[np.float64], usual: NDArray[np.int64]) -> HeldOut:
        """The frames to hold out of centred patterns, (K, n), if these are the usual ones."""
        nothing = np.zeros(0, np.int64)
        gram, pixels = values @ values.T, values.shape[1]
        # At most a quarter of the frames is held out: the rows need the others. Chosen by hand.
        most = max(len(values) // 4, len(usual))
        firsts, groups = [int(k) for k in usual], dict[int, list[int]]()
        # Frames that were not held out in the end may explain others.
        while firsts != [*groups]:
            firsts = [*groups] or firsts
            groups = _complete(firsts, gram, pixels, len(usual), most)
            if not groups:
                break
        frames = np.unique(np.concatenate([nothing, *groups.values()]))
        judged = np.array(sorted(groups), np.int64)
        rest = np.delete(values, frames, axis=0)
        off = (values[judged] - rest.mean(axis=0)) ** 2
        # Pixels whose values, less the mean of their pattern, differ by less than this never vary.
        # Patterns of one pixel each have means that differ by a pixel's share. If the contrast of
        # frames is mostly in such pixels, T is right where it is known, and predicts nothing.
        never = np.ptp(rest, axis=0) < 0.1
        # One frame alone has no variance.
        if len(judged) < 2 or off[:, never].sum() > off.sum() / 2:
            return cls(nothing, nothing)
        return cls(frames, judged)


def _complete(
    firsts: list[int], gram: NDArray[np.float64], pixels: int, usual: int, most: int
) -> dict[int, list[int]]:
    """Groups of frames, each of the first with all that predict it; those that fit into `most`.

    They hold about as many frames as are usual, and are two at least.
    """
    contrast = np.diag(gram)
    least = _ROUNDING * contrast.max()
    complete: dict[int, list[int]] = {}
    others = [k for k in firsts if contrast[k] > least]
    while others and not (len(complete) > 1 and sum(map(len, complete.values())) >= usual):
        first = others.pop(0)
        taken = [k for group in complete.values() for k in group]
        if first in taken:
            continue
        # Twins among the usual frames are one group.
        # Patterns whose squared cosine exceeds this are the same, or inverses of each other.
        alike = gram[first, others] ** 2 > 0.99 * contrast[first] * contrast[others]
        group = [first, *np.array(others, np.int64)[alike].tolist()]
        while len(taken) + len(group) <= most:
            # The frames still to come may be held out as well.
            rest = np.setdiff1d(np.arange(len(gram)), [*taken, *group, *others])
            share, strongest, rank = _unexplained(gram, first, rest)
            # A held-out frame tests an estimate if the remaining patterns leave at least half as
            # much of its contrast unexplained as they leave of a random pattern. Chosen on 60 small
            # captures.
            if share >= 0.5 * (1 - rank / max(pixels - 1, 1)) - 1e-6:
                complete[first] = group
                break
            group.append(strongest)
    return complete


def _unexplained(
    gram: NDArray[np.float64], frame: int, rest: NDArray[np.int64]
) -> tuple[float, int, int]:
    """The share of a frame's contrast that the rest leaves, what explains most, and their rank."""
    values, vectors = np.linalg.eigh(gram[np.ix_(rest, rest)])
    used = values > _ROUNDING * max(values[-1], 1e-300)
    across = gram[rest, frame]
    projected = vectors[:, used].T @ across
    explained = float((projected**2 / values[used]).sum())
    coefficients = vectors[:, used] @ (projected / values[used])
    weight = np.abs(coefficients) * np.sqrt(np.diag(gram)[rest])
    return 1 - explained / gram[frame, frame], int(rest[weight.argmax()]), int(used.sum())


# The most rows, evenly spread, whose residuals are looked at. Chosen by hand: what is wrong in all
# rows shows in these as well, and they cost little.
MOST_ROWS = 4096
# Fewer samples of a row that do not clip show no curve.
_FEWEST = 8


@dataclass(frozen=True, eq=False)
class Predicted:
    """Predicted samples of m rows under K patterns, (m, K) each, and the patterns' means, (K,)."""

    atoms: NDArray[np.float32]
    background: NDArray[np.float32]
    brightness: NDArray[np.float64]


def predicted_samples(
    solver: RowSolver, background: NDArray[np.float32], solved: Result, index: NDArray[np.int64]
) -> Predicted:
    """The predicted samples of some of the solved rows, with their background's, as shown."""
    patterns, brightness = solver.capture.patterns, solver.backgrounds.brightness
    if not len(index):
        nothing = np.zeros((0, patterns.count), np.float32)
        return Predicted(nothing, nothing, brightness)
    pixels = solver.atoms.expand(csr_array(solved.coefficients[index], dtype=np.float32))
    used, place = np.unique(pixels.indices, return_inverse=True)
    own = csr_array((pixels.data, place, pixels.indptr), shape=(len(index), len(used)))
    light: NDArray[Any] = solved.background[index][:, None] * background[index, : patterns.count]
    if solved.cells.shape[1]:
        light = light + solved.cells[index] @ solver.backgrounds.shown_means
    of_atoms = np.asarray(own @ patterns.columns(used).T, np.float32).reshape(light.shape)
    return Predicted(of_atoms, np.asarray(light, np.float32), brightness)


def residual_diagnostics(
    solver: RowSolver, samples: Samples, background: NDArray[np.float32], solved: Result,
    pixels: csr_array, chosen: NDArray[np.int64],
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """The diagnostics of solved rows that their samples and residuals give.

    `pixels` are the rows as pixels. `only_bounded` and `glint` are of all rows, `constant_light`
    and `bend` are of the `chosen` ones, and NaN of others.
    """
    shown, few = predicted_samples(solver, background, solved, chosen), samples.rows(chosen)
    constant, bent = (np.full(len(samples.values), np.nan) for _ in range(2))
    constant[chosen], bent[chosen] = constant_light(few, shown), bend(few, shown)
    bounded = only_bounded(samples, pixels, solver.capture.patterns)
    clipped = samples.clipped.mean(axis=1)
    # Rows that are only bounded and clip in more than this share of K photographs see a glint:
    # several projector pixels clip them alone. Rows of intact captures reach 0.69, glints 30 to 100
    # times as bright as the rest clip in 0.77 to 1. Chosen on 180 small captures.
    many = 0.72 + 1.5 / samples.clipped.shape[1]
    return {
        "only_bounded": bounded, "glint": bounded & (clipped > many), "constant_light": constant,
        "bend": bent,
    }  # fmt: skip


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
    # Patterns are alike in brightness if their means vary by less than this share of it. Chosen by
    # hand: the means of random patterns of 128 x 128 pixels vary by 0.8 %.
    if predicted.brightness.std() > 0.004 * mean:
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
