"""A truth as a colour camera sees it under the primaries of a colour projector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport

# The share of each primary's light that passes the filter of each camera channel, as (channel,
# primary) in the order red, green, blue. Chosen by hand to overlap about as much as the filters of
# real cameras.
FILTERS: NDArray[np.float32] = np.array(
    [[1.0, 0.2, 0.03], [0.12, 1.0, 0.15], [0.03, 0.2, 1.0]], np.float32
)
FILTERS.setflags(write=False)


def in_primary(truth: Truth, primary: str) -> Truth:
    """T of a scene lit by one primary, with three rows a camera pixel scaled by `FILTERS`."""
    if primary not in COLOURS:
        hint = f"use one of {', '.join(COLOURS)}"
        raise InputError(f"there is no primary {primary!r}", hint=hint)
    number = COLOURS.index(primary)
    band = slice(number, None, 3) if len(truth.camera_shape) == 3 else slice(None)
    rows = np.repeat(np.arange(truth.matrix.shape[0])[band], 3)
    matrix = truth.matrix[rows]
    gains = np.resize(FILTERS[:, number], len(rows)).repeat(np.diff(matrix.indptr))
    scaled = replace(truth, matrix=matrix).with_data(gains * matrix.data)
    return replace(
        truth, matrix=scaled, direct_data=gains * truth.direct[rows].data,
        camera_shape=(*truth.camera_shape[:2], 3), metadata={**truth.metadata, "primary": primary},
    )  # fmt: skip


def in_all_primaries(truth: Truth) -> Truth:
    """T of a colour projector: the grids of red, green and blue side by side, as `ColourPatterns`.

    Each row of projector pixels holds those of red, then of green, then of blue.
    """
    parts = [in_primary(truth, primary) for primary in COLOURS]
    rows, cols = truth.projector_shape
    # The columns of the three matrices, in the order of a projector three times as wide.
    place = np.arange(3 * rows * cols).reshape(3, rows, cols).swapaxes(0, 1).ravel()

    # Direct light is the imaginary part of the same entries, so that both are moved alike.
    both = [part.with_data(part.matrix.data + 1j * part.direct_data) for part in parts]
    whole = csr_array(csr_array(hstack(both, format="csr"))[:, place])
    return replace(
        parts[0],
        matrix=csr_array((whole.data.real.copy(), whole.indices, whole.indptr), whole.shape),
        direct_data=whole.data.imag.copy(),
        projector_shape=(rows, 3 * cols),
        metadata={**parts[0].metadata, "primary": "all"},
        geometry=None,
    )


def is_of_all_primaries(truth: Truth | LightTransport) -> bool:
    """Whether a T is that of a colour projector, as `in_all_primaries` makes it."""
    facts = truth.metadata if isinstance(truth, Truth) else truth.provenance
    return facts.get("primary") == "all"


def of_primary(transport: LightTransport, primary: str) -> LightTransport:
    """The part of a colour projector's T that belongs to one primary."""
    rows, wide = transport.projector_shape
    cols = wide // 3
    first = COLOURS.index(primary) * cols
    index = (np.arange(rows)[:, None] * wide + np.arange(first, first + cols)).ravel()
    return LightTransport.from_matrix(
        csr_array(transport.sparse[:, index]),
        transport.camera_shape,
        (rows, cols),
        provenance={**transport.provenance, "primary": primary},
    )
