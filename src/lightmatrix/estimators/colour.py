"""The estimate of a colour projector's T: one geometry for all channels and primaries.

A matrix G of a grey projector and camera is the geometry of all nine pairs of a camera channel a
and a primary b. Each camera pixel c has nine gains: T[(c, a), (q, b)] = M_c[a, b] G[c, q]. Grey
patterns, or a usual mixing of the filters, give a first G. Least squares then give the gains; their
inverse makes 3 K grey photographs of K in colour, which give a better G, and so on.
`docs/colour.md` explains it and has measurements.
"""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC
from lightmatrix.capture.capture import Capture, capture_of_samples, open_capture
from lightmatrix.capture.samples import Samples
from lightmatrix.check.finding import FINDINGS
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable, warn_of
from lightmatrix.errors import InputError
from lightmatrix.estimators.base import capture_provenance
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.kinds import COLOUR_STORES
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.progress import Progress
from lightmatrix.progress_bar import progress_bar
from lightmatrix.transport.matrix import ColourTransport, LightTransport
from lightmatrix.transport.store import save_colour

Floats = NDArray[np.float64]

PRIMARIES = len(COLOURS)
# The mixing before any is measured: filters that pass a quarter of the next primary's light, and a
# tenth of that after it. Chosen by hand. It needs not be right: the geometry that it gives is a
# first guess.
USUAL_MIXING = np.array([[1.0, 0.25, 0.1], [0.25, 1.0, 0.25], [0.1, 0.25, 1.0]])
# Gains are scaled so that the mean channel sees all of a white pattern's light.
_WHITE = float(PRIMARIES)
# Relative size of what keeps a system of equations regular.
_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class ColourSamples:
    """Samples of n camera pixels in three channels under K patterns of a colour projector."""

    patterns: ColourPatterns
    # Linear samples (n, 3, K), which of them are clipped, and their weights.
    values: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, samples: Samples, patterns: ColourPatterns) -> "ColourSamples":
        """The samples of all rows of a capture."""
        shape = (-1, PRIMARIES, patterns.count)
        weights = samples.weights_of_all().astype(np.float32).reshape(shape)
        values = np.asarray(samples.values, np.float32).reshape(shape)
        return cls(patterns, values, samples.clipped.reshape(shape), weights)

    @property
    def pixels(self) -> int:
        """Number of camera pixels n."""
        return len(self.values)


def light_of_primaries(geometry: LightTransport, patterns: ColourPatterns) -> NDArray[np.float32]:
    """What a grey camera would see of each primary's pattern, G p, (n, 3, K)."""
    light = [geometry.multiplied(one.dense().T) for one in patterns.primaries]
    return np.stack(light, axis=1).astype(np.float32)


def usual_gains(pixels: int) -> Floats:
    """The usual mixing for all camera pixels, (n, 3, 3)."""
    usual = USUAL_MIXING * (_WHITE / USUAL_MIXING.sum())
    return np.broadcast_to(usual, (pixels, *usual.shape))


def fit_gains(samples: ColourSamples, light: NDArray[np.float32], trust: float) -> Floats:
    """The gains (n, 3, 3) of channel by primary that explain the samples best.

    The least-squares gains of each channel are drawn to the mixing of the whole frame, times one
    factor for the channel: `trust` is the weight of this expectation relative to the samples. They
    are not negative, and scaled so that the mean channel sees all light of white.
    """
    known = samples.weights * ~samples.clipped
    gram = np.einsum("nbk,nck,nak->nabc", light, light, known, optimize=True).astype(float)
    right = np.einsum("nbk,nak->nab", light, known * samples.values, optimize=True).astype(float)
    scale = np.trace(gram, axis1=2, axis2=3)[..., None, None] / PRIMARIES
    eye = np.eye(PRIMARIES)
    first = _solved(gram + (_TINY + scale * _TINY) * eye, right)
    mixing = _of_frame(first, samples.values.mean(axis=2).sum(axis=1))
    # How strongly the channel sees light of the frame's mixing.
    energy = np.einsum("nabc,ab,ac->na", gram, mixing, mixing)
    factor = np.einsum("nab,ab->na", right, mixing) / np.maximum(energy, 1e-30)
    expected = np.maximum(factor, 0)[..., None] * mixing
    drawn = _solved(gram + (_TINY + trust * scale) * eye, right + trust * scale[..., 0] * expected)
    gains = np.maximum(drawn, 0)
    total = gains.sum(axis=(1, 2), keepdims=True)
    usual = usual_gains(len(gains))
    return np.where(total > 0, gains * (_WHITE / np.where(total > 0, total, 1)), usual)


def _solved(matrices: Floats, right: Floats) -> Floats:
    return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])


def _of_frame(gains: Floats, light: NDArray[np.float32]) -> Floats:
    """The median share of each primary in what a channel sees, (3, 3), over pixels with light."""
    # Pixels darker than this share of the mean say nothing of the frame's mixing. Chosen by hand.
    bright = light > 0.1 * light.mean()
    total = gains.sum(axis=2, keepdims=True)
    fine = bright[:, None] & (total[..., 0] > 0)
    shares = np.divide(gains, total, out=np.full_like(gains, np.nan), where=fine[..., None])
    if not fine.any(axis=0).all():
        return USUAL_MIXING / USUAL_MIXING.sum(axis=1, keepdims=True)
    return np.maximum(np.nanmedian(shares, axis=0), 0)


# What keeps the inverse of a mixing regular, relative to gains of about 1. The weight of primaries
# that a pixel hardly sees is then nearly 0.
_LEAST_GAIN = 1e-4
# A level that no sample reaches.
_NEVER = np.float32(1e9)


def grey_capture(samples: ColourSamples, camera_shape: tuple[int, ...], exposure: float) -> Capture:
    """The grey photographs as those of a grey camera: the means of the three channels."""
    chosen = np.flatnonzero(samples.patterns.grey)
    equal = np.full((samples.pixels, PRIMARIES), 1 / PRIMARIES)
    known = _grey_samples(samples, equal, chosen)
    return capture_of_samples(samples.patterns.red.subset(chosen), known, camera_shape, exposure)


def unmixed_capture(
    samples: ColourSamples, gains: Floats, camera_shape: tuple[int, ...], exposure: float,
) -> Capture:  # fmt: skip
    """The photographs as those of a grey camera under grey patterns, one for each primary.

    A grey photograph stays one, with less noise. Where the gains (n, 3, 3) hardly tell a primary
    from the others, its noise is large, and its weight low in proportion.
    """
    grey = np.flatnonzero(samples.patterns.grey)
    coloured = np.flatnonzero(~samples.patterns.grey)
    white = gains.sum(axis=2)
    white /= np.maximum((white**2).sum(axis=1, keepdims=True), _LEAST_GAIN)
    parts = _grey_samples(samples, white, grey), _separated_samples(samples, gains, coloured)
    names = "values", "clipped", "clip_level", "weights"
    each = ([getattr(part, name) for part in parts] for name in names)
    known = Samples(*(np.concatenate(arrays, axis=1) for arrays in each))
    # The grey patterns, then those of red, green and blue in the others.
    sets = [one.subset(coloured) for one in samples.patterns.primaries]
    if len(grey):
        sets.insert(0, samples.patterns.red.subset(grey))
    bits = [each for each in (one.as_bits() for one in sets) if each is not None]
    patterns: PatternSet = (
        BitPatterns(samples.patterns.red.shape, np.concatenate(bits))
        if len(bits) == len(sets)
        else ImagePatterns(np.concatenate([one.images() for one in sets]))
    )
    return capture_of_samples(patterns, known, camera_shape, exposure)


def _grey_samples(samples: ColourSamples, shares: Floats, frames: NDArray[np.int64]) -> Samples:
    """Sums of the three channels with shares (n, 3); of clipped ones a lower bound."""
    values = np.einsum("na,nak->nk", shares, samples.values[..., frames], optimize=True)
    clipped = np.any(samples.clipped[..., frames], axis=1)
    return _bounded(values, np.asarray(clipped), samples.weights[..., frames].min(axis=1))


def _separated_samples(samples: ColourSamples, gains: Floats, frames: NDArray[np.int64]) -> Samples:
    """The light of red, then green, then blue in some frames, (n, 3 K).

    More light in a clipped channel would mean more of the primary that it sees most, and less of
    the others: of the first there is a lower bound, the others are left out.
    """
    count = samples.pixels
    inverse = np.linalg.inv(gains + _LEAST_GAIN * np.eye(PRIMARIES))
    values = np.einsum("nba,nak->nbk", inverse, samples.values[..., frames], optimize=True)
    hidden = samples.clipped[..., frames]
    falls = np.einsum("nba,nak->nbk", inverse < 0, hidden, optimize=True)
    clipped = np.broadcast_to(np.any(hidden, axis=1, keepdims=True), values.shape)
    noise = np.maximum((inverse**2).sum(axis=2), 1)[..., None]
    weights = samples.weights[..., frames].min(axis=1)[:, None] / noise * ~falls
    flat = (count, -1)
    return _bounded(values.reshape(flat), (clipped & ~falls).reshape(flat), weights.reshape(flat))


def _bounded(
    values: NDArray[np.floating], clipped: NDArray[np.bool_], weights: NDArray[np.floating]
) -> Samples:
    """Samples whose clipped ones are at their clip level, as lower bounds are."""
    single = values.astype(np.float32)
    levels = np.where(clipped, single, _NEVER)
    return Samples(single, clipped, levels, weights.astype(np.float32))


# How much gains are drawn to the mixing of the whole frame, in each round after the start. First
# the geometry of some pixels is wrong, and so would be their own gains; then it is right.
TRUSTS = (0.3, 0.03)


def estimate_colour(
    capture: Capture | str | Path,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    check: bool = True,
    progress: Progress | bool = True,
) -> ColourTransport:
    """Estimate T of a colour projector, whose primaries and camera channels share their geometry.

    Parameters
    ----------
    capture : Capture, str or Path
        Photographs of a camera with three channels under `ColourPatterns`; or a capture folder.
    output : str or Path, optional
        A folder to write as well, with a store for each primary: red.zarr, green.zarr, blue.zarr.
    overwrite : bool
        Whether a folder of stores at `output` may be replaced.
    check : bool
        Whether to refuse photographs that do not follow their patterns, and to warn of what else
        `lm.check` finds. The provenance keeps it.
    progress : bool or callable
        Whether to show a bar on a terminal and in notebooks; or what to call with (done, total).

    Returns
    -------
    ColourTransport
        The matrices of red, green and blue, of three rows a camera pixel. Estimated errors are
        those of the geometry, alike for all channels and primaries of a camera pixel.

    Raises
    ------
    InputError
        If patterns or camera are grey, responses are to be found, or the capture is unusable.
    OutputError
        If the output exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.colour_bernoulli((64, 64), 32)
    >>> capture = lm.simulate("metal", patterns, exposure=0.4)
    >>> colour = lm.estimate_colour(capture)  # doctest: +SKIP
    >>> image = colour.relight(np.ones((64, 64, 3)))  # doctest: +SKIP
    """
    capture = open_capture(capture)
    patterns = capture.patterns
    if not isinstance(patterns, ColourPatterns) or patterns.grey.all():
        hint = "use lm.estimate, or `lightmatrix estimate`"
        raise InputError("the patterns are grey, or of one colour", hint=hint)
    if capture.camera_shape[2:] != (PRIMARIES,):
        raise InputError(
            "patterns of several colours, but a camera without three channels",
            hint="photograph them with a colour camera; or show and photograph all patterns in "
            "red, then in green, then in blue, as captures of their own",
        )
    if capture.projector_unknown or capture.decoder.response.name == AUTOMATIC:
        raise InputError(
            "responses are to be found (auto), which photographs in colour do not allow yet",
            hint="state the curves, which `lightmatrix response` measures",
        )
    check_output(output, COLOUR_STORES, overwrite=overwrite)
    refuse_unusable(capture)
    findings = refuse_unordered(capture) if check else []
    warn_of(findings)
    samples = ColourSamples.of(capture.samples(), patterns)
    seen = capture.camera_shape[:2], float(capture.exposures.max())
    # Grey patterns from which the geometry is found without the others. Fewer show where most
    # camera pixels look, but not all. The usual mixing is the better start then (docs/colour.md).
    if patterns.grey.sum() >= 12:
        grey = grey_capture(samples, *seen)
    else:
        grey = unmixed_capture(samples, usual_gains(samples.pixels), *seen)
    with progress_bar("estimating", "rows") if progress is True else nullcontext(None) as bar:
        report = progress if callable(progress) else bar
        geometry, steps = None, len(TRUSTS) + 1
        for number in range(steps):
            if geometry is not None:
                light = light_of_primaries(geometry, patterns)
                gains = fit_gains(samples, light, TRUSTS[number - 1])
                grey = unmixed_capture(samples, gains, *seen)

            def show(done: int, total: int, number: int = number) -> None:
                if report is not None:
                    report(number * total + done, steps * total)

            geometry = CoherentEstimator().estimate(grey, progress=show)
    assert geometry is not None
    # The gains of the result are drawn less to the mixing of the whole frame.
    gains = fit_gains(samples, light_of_primaries(geometry, patterns), 0.003)
    provenance = {
        **geometry.provenance, **capture_provenance(capture), "estimator": "colour",
        FINDINGS: [finding.as_dict() for finding in findings],
    }  # fmt: skip
    # T of a primary has each row of the geometry three times, times that channel's gain (n, 3).
    pixel = np.repeat(np.arange(samples.pixels), PRIMARIES)
    diagnostics = {key: values[pixel] for key, values in geometry.diagnostics.items()}
    diagnostics["clipped_share"] = samples.clipped.mean(axis=2, dtype=np.float32).ravel()
    parts = []
    for number, name in enumerate(COLOURS):
        factors = gains[..., number].ravel().astype(np.float32)
        sparse = geometry.sparse[pixel]
        sparse.data *= np.repeat(factors, np.diff(sparse.indptr))
        background = geometry.background[pixel] * factors[:, None]
        shapes = capture.camera_shape, geometry.projector_shape, geometry.background_grid
        made_by = {**provenance, "primary": name}
        parts.append(LightTransport(sparse, background, *shapes, diagnostics, made_by))
    colour = ColourTransport(*parts)
    if output is not None:
        save_colour(output, colour, overwrite=overwrite)
    return colour
