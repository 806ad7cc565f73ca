"""The equation from which the bends of a response follow, and its solution by an estimate of T.

Light adds up. What a camera pixel shows under many patterns is therefore a sum that can be
predicted, and a curve that bends the light leaves a trace that no sum explains.

Under the true response, the light z of a row of camera samples is z = P t, with the patterns P and
the row t of T. Under another one it is bent: z + sum_j c_j phi_j(z) = P t + noise. A projection R
that removes the columns of P that matter leaves R (z + sum_j c_j phi_j(z)) = noise. Both sides are
multiplied by R phi_i(x), where x is the light that is predicted for each sample:

    sum_rows (R phi_i(x))' R (z + sum_j c_j phi_j(z)) = 0,   one equation for each i.

The prediction x makes the equation right on average (it is an instrument, in the word of
statistics): phi at the samples themselves holds their noise, which would shrink c.

The projector turns a grey value g into the light g^k. If q is the light under a k that is too small
by a share d, the light is q^(1 + d), nearly q + d q ln q. A row t of T then shows

    z = P t + d psi(P) t,   psi(q) = q ln q,

which is solved for d likewise. The projector pixels of each row are those of an estimate of T;
their weights are fitted again after each change of k.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.found_response import (
    GAMMAS,
    Bend,
    GammaBend,
    bent_light,
    raised,
    with_response,
)
from lightmatrix.capture.samples import Samples
from lightmatrix.check.survey import sums_by_group
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.transport.matrix import LightTransport

Array = NDArray[np.float64]
Change = Callable[[Array], Array]

# Fewer rows determine nothing. Rows clip in at most 30 % of the frames, and vary by more than 15 %
# of what the most varied tenth does.
FEWEST_ROWS, MOST_CLIPPED, VARIED = 20, 0.3, 0.15


@dataclass(frozen=True, eq=False)
class Rows:
    """m rows of K samples: their light, the light predicted for them, and what explains it.

    Parameters
    ----------
    light, predicted : (m, K) float64
        Share of full light, with all that is not from the projector.
    dark : (m, K) float64
        The part of it that is not from the projector: the pedestal and the room's light.
    usable : (m, K) bool
        Which samples are not clipped and may be compared.
    columns : (m, K, d) float64
        What explains the light of each row up to weights.
    part : (m,) int64
        Rows with the same number may miss the same light: only their sums scatter independently.
    change : (m, K) float64, optional
        How the predicted light changes with the logarithm of the projector's gamma; it is then
        solved for as the last bend.
    weight : (m,) float64, optional
        How much each row counts; all count alike by default.
    """

    light: Array
    predicted: Array
    dark: Array
    usable: NDArray[np.bool_]
    columns: Array
    part: NDArray[np.int64]
    change: Array | None = None
    weight: Array | None = None

    def select(self, index: NDArray[np.bool_]) -> Rows:
        """Some of the rows."""
        known = {each.name: getattr(self, each.name) for each in fields(self)}
        chosen = {name: values[index] for name, values in known.items() if values is not None}
        return replace(self, **chosen)


@dataclass(frozen=True, eq=False)
class Bends:
    """The sizes of the bends (c,), and their covariance (c, c) from the scatter of the rows."""

    sizes: Array
    covariance: Array

    @property
    def errors(self) -> Array:
        """Standard error of each size."""
        return np.sqrt(np.diag(self.covariance))


def light_of(
    values: Array, samples: Samples, decoder: Decoder, exposures: Array
) -> tuple[Array, Array]:
    """Light of sample values (m, K), as a share of full light, and the dark part of it."""
    full = float(np.max(decoder.response.linearise(np.asarray(decoder.clip) / decoder.full_scale)))
    pedestal = decoder.response.linearise(np.asarray(decoder.black_level) / decoder.full_scale)
    unit = exposures * (full - float(np.min(pedestal)))
    ceiling = np.broadcast_to(samples.clip_level, samples.values.shape)
    dark = full - ceiling * unit
    return np.asarray(values * unit + dark, np.float64), np.asarray(dark, np.float64)


def solve_bends(rows: Rows, response: Response, bend: Bend | None) -> Bends | None:
    """The bends of rows that were decoded by a response; None if they do not determine any.

    Without `bend`, the response is right, and only the rows' `change` is solved for.
    """
    usable = rows.usable
    basis, strength, _ = np.linalg.svd(rows.columns * usable[..., None], full_matrices=False)
    # Weaker directions are rounding errors of columns that depend on each other.
    basis = basis * (strength > 1e-6 * strength[:, :1])[:, None, :]

    def projected(values: Array) -> Array:
        masked = values * usable
        inside = np.einsum("mkd,...mk->...md", basis, masked)
        return (masked - np.einsum("mkd,...md->...mk", basis, inside)) * usable

    def bends(light: Array) -> Array:
        if bend is None:
            return np.empty((0, *light.shape))
        shares = np.clip(light, 0, 1)
        return bend.functions(shares, response) - bend.functions(np.clip(rows.dark, 0, 1), response)

    # Predicted light counts as at least half a step of 8 bits of the brightest light. Full light is
    # no measure: the photographs of a camera of 12 bits may use a sixteenth of their range.
    faintest = 0.002 * float(rows.light.max(initial=0.0))
    instrument = projected(bends(np.clip(rows.predicted, faintest, 1)))
    bent = projected(bends(rows.light))
    if rows.change is not None:
        change = projected(-rows.change)[None]
        instrument, bent = np.concatenate([instrument, change]), np.concatenate([bent, change])
    if rows.weight is not None:
        instrument = instrument * rows.weight[:, None]
    left = projected(rows.light - rows.dark)
    matrices = np.einsum("imk,jmk->mij", instrument, bent)
    sides = np.einsum("imk,mk->mi", instrument, left)
    matrix = matrices.sum(axis=0)
    if not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1e12:
        return None
    inverse = np.linalg.inv(matrix)
    sizes = -inverse @ sides.sum(axis=0)
    each = sums_by_group(sides + matrices @ sizes, rows.part)
    return Bends(sizes, inverse @ (each.T @ each) @ inverse.T)


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
    sparse, background = transport.sparse[index], transport.background[index]
    # T p of each row under every pattern, (m, K).
    shown = np.empty((len(index), capture.count))
    for start, chunk in patterns.chunks():
        seen = sparse @ chunk.T + background @ (transport.pooling @ chunk.T)
        shown[:, start : start + len(chunk)] = seen
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
    # They are drawn from at most 64 runs of at most 256 neighbouring rows.
    length = min(256, -(-total // 64))
    starts = np.unique(np.linspace(0, total - length, min(64, -(-total // length))).astype(int))
    runs = [np.arange(start, start + length) for start in starts]
    index = np.concatenate(runs)
    samples = Samples.joined([capture.samples(run[0], run[-1] + 1) for run in runs])
    spread = samples.values.std(axis=1)
    usable = capture.valid[index] & (samples.clipped.mean(axis=1) <= MOST_CLIPPED) & (spread > 0)
    if usable.any():
        usable &= spread > VARIED * np.quantile(spread[usable], 0.9)
    chosen = np.sort(np.random.default_rng(0).permutation(np.flatnonzero(usable))[:2000])
    return index[chosen], samples.rows(chosen)


def strongest_pixels(
    transport: LightTransport, index: NDArray[np.int64], frames: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The strongest projector pixels of some rows, and their light, (m, count) each.

    There are at most six, and one for five `frames`.
    """
    count = max(1, min(6, frames // 5))
    sparse = transport.sparse[index]
    sizes = np.diff(sparse.indptr)
    owner = np.repeat(np.arange(len(index)), sizes)
    order = np.lexsort((-sparse.data, owner))
    rank = np.arange(len(owner)) - np.repeat(sparse.indptr[:-1], sizes)
    owner, rank, order = (each[rank < count] for each in (owner, rank, order))
    pixels = np.zeros((len(index), count), np.int64)
    light = np.zeros((len(index), count))
    pixels[owner, rank] = sparse.indices[order]
    light[owner, rank] = sparse.data[order]
    return pixels, light


@dataclass(frozen=True)
class _LitRows:
    """Rows of an estimate of T: their strongest pixels, (m, count), and T without these."""

    index: NDArray[np.int64]
    strongest: NDArray[np.int64]
    weights: Array
    transport: LightTransport

    def lit(self, patterns: PatternSet, change: Change) -> tuple[Array, Array]:
        """The changed light at the strongest pixels, (m, K, count), and what others show, (m, K).

        A chunk of the patterns is changed at a time: all of them may take gigabytes.
        """
        part = np.moveaxis(change(patterns.at(self.strongest).astype(np.float64)), 0, 1)
        sparse = self.transport.sparse[self.index]
        background = self.transport.background[self.index]
        whole = np.empty((len(self.index), patterns.count))
        for start, chunk in patterns.chunks():
            light = change(chunk.astype(np.float64)).T
            seen = sparse @ light + background @ (self.transport.pooling @ light)
            whole[:, start : start + len(chunk)] = seen
        return part, whole - np.einsum("mkd,md->mk", part, self.weights)


def gammas_from_greys(
    capture: Capture, transport: LightTransport, gamma: float, *, camera: bool
) -> tuple[Capture, float, Bends] | None:
    """The capture under the better camera curve, the projector's better gamma, and the last step.

    `capture` has grey values as patterns; `transport` was estimated under its response and `gamma`.
    Without `camera`, its response is right. None if too few rows tell anything.
    """
    index, _ = choose_rows(capture)
    if len(index) < FEWEST_ROWS:
        return None
    rows = _LitRows(index, *strongest_pixels(transport, index, capture.count), transport)
    greys = capture.patterns
    for number in range(8):
        patterns = ProjectorResponse.of_gamma(gamma).light_of_patterns(greys)
        found = _off_by(capture, rows, patterns, camera)
        if found is None:
            return None
        # Beyond 30 % the linear change of the light misleads.
        sizes = np.clip(found.sizes, -0.3, 0.3)
        gamma = float(np.clip(gamma * (1 + sizes[-1]), *GAMMAS))
        if camera:
            better = raised(capture.decoder.response, 1 + float(sizes[0]))
            capture = with_response(capture, better)
        # Five steps were the most that were needed.
        if np.abs(sizes).max() < 0.002 or number == 7:
            return capture, gamma, found
    return None


def _off_by(capture: Capture, rows: _LitRows, patterns: PatternSet, camera: bool) -> Bends | None:
    """How much the camera's and the projector's gamma are off, as shares of them."""
    samples = capture.samples().rows(rows.index)
    exposures = capture.exposures
    values, dark = light_of(samples.values, samples, capture.decoder, exposures)
    unit = light_of(np.ones_like(values), samples, capture.decoder, exposures)[0] - dark
    usable = samples.counted & ~samples.clipped
    lit, rest = rows.lit(patterns, np.asarray)
    turned, turned_rest = rows.lit(patterns, bent_light)
    even = np.ones((*values.shape, 1))
    columns = np.concatenate([even, rest[..., None], lit], axis=2)
    weights = explaining_weights(columns, samples, usable)
    predicted, _ = light_of(
        np.einsum("mkd,md->mk", columns, weights), samples, capture.decoder, exposures
    )
    change = turned_rest * weights[:, 1:2] + np.einsum("mkd,md->mk", turned, weights[:, 2:])
    alone = np.arange(len(values))
    bent = Rows(values, predicted, dark, usable, columns * unit[..., None], alone, change * unit)
    return solve_bends(bent, capture.decoder.response, GammaBend() if camera else None)


def explaining_weights(columns: Array, samples: Samples, usable: NDArray[np.bool_]) -> Array:
    """The weights of columns (m, K, d) that explain samples best; pixels give no negative light."""
    counted = columns * usable[..., None]
    gram = np.einsum("mkd,mke->mde", counted, counted)
    sides = np.einsum("mkd,mk->md", counted, samples.values)
    # Weights that the frames do not determine are kept small.
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2)
    # Rows without usable samples get no weights.
    ridge[ridge == 0] = 1
    diagonal = ridge[:, None, None] * np.eye(gram.shape[1])
    weights = np.linalg.solve(gram + diagonal, sides[..., None])[..., 0]
    weights[:, 2:] = np.maximum(weights[:, 2:], 0)
    return np.asarray(weights)
