"""The response by an estimate of T: what is left where T has explained what it can."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.responses.bend import Bend
from lightmatrix.diagnosis.responses.trace import Bends, Rows, light_of, solve_bends
from lightmatrix.transport.matrix import LightTransport

# Rows that are used, drawn from at most so many runs of neighbouring rows of at most this length.
_ROWS, _RUNS, _RUN = 2000, 64, 256
# Fewer rows determine nothing.
FEWEST_ROWS = 20
# Rows clip in at most 30 % of the frames, and vary by more than 15 % of what the most varied tenth
# does.
_MOST_CLIPPED, _VARIED = 0.3, 0.15
# The strongest pixels of a row that are removed: at most six, and one for five patterns.
_PIXELS, _PATTERNS_EACH = 6, 5


def bends_from_transport(capture: Capture, transport: LightTransport, bend: Bend) -> Bends | None:
    """The bends of a capture's response, by the T that was estimated under it.

    `transport` has a row for each camera sample of the capture. None if too few rows tell anything.
    """
    index, samples = choose_rows(capture)
    if len(index) < FEWEST_ROWS:
        return None
    strongest, weights = strongest_pixels(transport, index, capture.count)
    patterns = capture.patterns
    lit = np.moveaxis(patterns.at(strongest), 0, 1).astype(np.float64)
    shown = _predicted(capture, transport, index)
    rest = shown - np.einsum("mkd,md->mk", lit, weights)
    exposures = capture.exposures
    light, dark = light_of(samples.values, samples, capture.decoder, exposures)
    predicted, _ = light_of(shown, samples, capture.decoder, exposures)
    even = np.ones((*light.shape, 1))
    columns = np.concatenate([even, shown[..., None], rest[..., None], lit], axis=2)
    rows = Rows(
        light,
        predicted,
        dark,
        samples.counted & ~samples.clipped,
        columns * exposures[None, :, None],
        # T explains far light, too: rows miss nothing that is alike.
        np.arange(len(light)),
    )
    return solve_bends(rows, capture.decoder.response, bend)


def choose_rows(capture: Capture) -> tuple[NDArray[np.int64], Samples]:
    """Rows of the capture that vary much and clip little, with their samples."""
    total = capture.rows
    length = min(_RUN, -(-total // _RUNS))
    starts = np.unique(np.linspace(0, total - length, min(_RUNS, -(-total // length))).astype(int))
    runs = [np.arange(start, start + length) for start in starts]
    index = np.concatenate(runs)
    samples = Samples.joined([capture.samples(run[0], run[-1] + 1) for run in runs])
    spread = samples.values.std(axis=1)
    usable = capture.valid[index] & (samples.clipped.mean(axis=1) <= _MOST_CLIPPED) & (spread > 0)
    if usable.any():
        usable &= spread > _VARIED * np.quantile(spread[usable], 0.9)
    chosen = np.sort(np.random.default_rng(0).permutation(np.flatnonzero(usable))[:_ROWS])
    return index[chosen], samples.rows(chosen)


def _predicted(
    capture: Capture, transport: LightTransport, index: NDArray[np.int64]
) -> NDArray[np.float64]:
    """T p of some rows under every pattern, (m, K)."""
    sparse, background = transport.sparse[index], transport.background[index]
    shown = np.empty((len(index), capture.count))
    for start, chunk in capture.patterns.chunks():
        light = sparse @ chunk.T + background @ (transport.pooling @ chunk.T)
        shown[:, start : start + len(chunk)] = light
    return shown


def strongest_pixels(
    transport: LightTransport, index: NDArray[np.int64], frames: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The strongest projector pixels of some rows, and their light, (m, count) each.

    There are at most six, and one for five `frames`.
    """
    count = max(1, min(_PIXELS, frames // _PATTERNS_EACH))
    sparse = transport.sparse[index]
    pixels = np.zeros((len(index), count), np.int64)
    light = np.zeros((len(index), count))
    for row, (start, stop) in enumerate(zip(sparse.indptr[:-1], sparse.indptr[1:], strict=True)):
        values = sparse.data[start:stop]
        best = np.argsort(-values)[:count]
        pixels[row, : len(best)] = sparse.indices[start:stop][best]
        light[row, : len(best)] = values[best]
    return pixels, light
