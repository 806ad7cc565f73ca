"""The projector's gamma by random grey patterns, alone or together with the camera's.

The projector turns a grey value g into the light g^k. If q is the light under a k that is too small
by a share d, the light is q^(1 + d), nearly q + d q ln q. A row t of T then shows

    z = P t + d psi(P) t,   psi(q) = q ln q,

which `trace.py` solves for d as it does for the bends of the camera's curve. The projector pixels
of each row are those of an estimate of T; their weights are fitted again after each change of k.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.diagnosis.responses.bend import GammaBend, raised
from lightmatrix.diagnosis.responses.found import with_response
from lightmatrix.diagnosis.responses.from_transport import (
    FEWEST_ROWS,
    choose_rows,
    strongest_pixels,
)
from lightmatrix.diagnosis.responses.trace import Bends, Rows, light_of, solve_bends
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.transport.matrix import LightTransport

Array = NDArray[np.float64]
Change = Callable[[Array], Array]

# Light below this counts as this much; its logarithm must be finite. A grey value of 1 of 255 at a
# gamma of 2.5 is as bright.
_DARKEST = 1e-6
# A step changes a gamma by at most 30 %, beyond which the linear change of the light misleads. The
# steps end when one changes no gamma by 0.2 %, or after eight; five were the most that were needed.
_LARGEST, _SMALL, _STEPS = 0.3, 0.002, 8
# Gammas of projectors lie well within this range.
GAMMAS = (0.2, 6.0)
# Weights that the frames do not determine are kept small: a millionth of the mean power of columns.
_RIDGE = 1e-6


@dataclass(frozen=True)
class _Rows:
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
    rows = _Rows(index, *strongest_pixels(transport, index, capture.count), transport)
    greys = capture.patterns
    for number in range(_STEPS):
        patterns = ProjectorResponse.of_gamma(gamma).light_of_patterns(greys)
        found = _step(capture, rows, patterns, camera)
        if found is None:
            return None
        sizes = np.clip(found.sizes, -_LARGEST, _LARGEST)
        gamma = float(np.clip(gamma * (1 + sizes[-1]), *GAMMAS))
        if camera:
            better = raised(capture.decoder.response, 1 + float(sizes[0]))
            capture = with_response(capture, better)
        if np.abs(sizes).max() < _SMALL or number == _STEPS - 1:
            return capture, gamma, found
    return None


def _step(capture: Capture, rows: _Rows, patterns: PatternSet, camera: bool) -> Bends | None:
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


def bent_light(light: Array) -> Array:
    """How light changes with the logarithm of the projector's gamma."""
    return np.asarray(light * np.log(np.maximum(light, _DARKEST)))


def explaining_weights(columns: Array, samples: Samples, usable: NDArray[np.bool_]) -> Array:
    """The weights of columns (m, K, d) that explain samples best; pixels give no negative light."""
    counted = columns * usable[..., None]
    gram = np.einsum("mkd,mke->mde", counted, counted)
    sides = np.einsum("mkd,mk->md", counted, samples.values)
    ridge = _RIDGE * np.trace(gram, axis1=1, axis2=2)
    # Rows without usable samples get no weights.
    ridge[ridge == 0] = 1
    diagonal = ridge[:, None, None] * np.eye(gram.shape[1])
    weights = np.linalg.solve(gram + diagonal, sides[..., None])[..., 0]
    weights[:, 2:] = np.maximum(weights[:, 2:], 0)
    return np.asarray(weights)
