"""The equation from which the bends of a response follow.

Under the true response, the light z of a row of camera samples is z = P t, with the patterns P and
the row t of T. Under another one it is bent: z + sum_j c_j phi_j(z) = P t + noise. A projection R
that removes the columns of P that matter leaves R (z + sum_j c_j phi_j(z)) = noise. Both sides are
multiplied by R phi_i(x), where x is the light that is predicted for each sample:

    sum_rows (R phi_i(x))' R (z + sum_j c_j phi_j(z)) = 0,   one equation for each i.

The prediction x makes the equation right on average (it is an instrument, in the word of
statistics): phi at the samples themselves holds their noise, which would shrink c.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.camera_curve import Response
from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.samples import Samples
from lightmatrix.diagnosis.responses.bend import Bend
from lightmatrix.diagnosis.statistics import sums_by_group

Array = NDArray[np.float64]

# Directions of a row's columns that are weaker than this share of the strongest are left in. They
# are rounding errors of columns that depend on each other.
_WEAKEST = 1e-6
# Predicted light counts as at least this share of the brightest light, half a step of 8 bits. Full
# light is no measure: the photographs of a camera of 12 bits may use a sixteenth of their range.
_FAINTEST = 0.002


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
    basis = _orthonormal(rows.columns * usable[..., None])

    def projected(values: Array) -> Array:
        masked = values * usable
        inside = np.einsum("mkd,...mk->...md", basis, masked)
        return (masked - np.einsum("mkd,...md->...mk", basis, inside)) * usable

    def bends(light: Array) -> Array:
        if bend is None:
            return np.empty((0, *light.shape))
        shares = np.clip(light, 0, 1)
        return bend.functions(shares, response) - bend.functions(np.clip(rows.dark, 0, 1), response)

    faintest = _FAINTEST * float(rows.light.max(initial=0.0))
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


def _orthonormal(columns: Array) -> Array:
    """Orthonormal columns that span the same, (m, K, d), with zeros for those that depend."""
    basis, strength, _ = np.linalg.svd(columns, full_matrices=False)
    kept = strength > _WEAKEST * strength[:, :1]
    return np.asarray(basis * kept[:, None, :])
