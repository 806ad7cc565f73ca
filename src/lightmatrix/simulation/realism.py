"""Effects of real projectors and cameras on a rendered T: blur, vignetting, room light, colour.

They change T itself, so that relighting and estimation see one consistent matrix.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, hstack, kron

from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.simulation.thinning import joined, thinned_in_steps
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import LightTransport


def defocus(truth: Truth, sigma: float) -> Truth:
    """Blur the projector by a Gaussian of `sigma` >= 0 projector pixels; its border loses light."""
    if sigma == 0:
        return truth
    rows, cols = truth.projector_shape
    across, along = (
        scipy.ndimage.gaussian_filter1d(np.float32(np.eye(n)), sigma, mode="constant", truncate=3)
        for n in (rows, cols)
    )

    def blurred(part: csr_array) -> NDArray[np.float32]:
        # Two products of large matrices are far faster than many products of small ones.
        once = (part.toarray().reshape(-1, cols) @ along).reshape(-1, rows, cols)
        twice = once.swapaxes(1, 2).reshape(-1, rows) @ across
        return twice.reshape(-1, cols, rows).swapaxes(1, 2).reshape(-1, rows * cols)

    # Dense rows of 32 MiB are blurred at once. Of their many entries, those stay that hold nearly
    # all of the light; the others are gathered (see `thinned`).
    step = max(1, (1 << 23) // (rows * cols))
    direct, parts = truth.direct, []
    for start in range(0, truth.matrix.shape[0], step):
        part = slice(start, start + step)
        whole = csr_array(blurred(truth.matrix[part]))
        row = np.repeat(np.arange(whole.shape[0]), np.diff(whole.indptr))
        straight = blurred(direct[part])[row, whole.indices]
        parts.append(thinned_in_steps(whole, straight, 0.9995))
    matrix, direct_data = joined(parts)
    return replace(truth, matrix=matrix, direct_data=direct_data)


def camera_defocus(truth: Truth, sigma: float) -> Truth:
    """Blur the camera by a Gaussian of `sigma` >= 0 camera pixels, which mixes the rows of T."""
    if sigma == 0:
        return truth
    sides = truth.camera_shape[:2]
    across, along = (
        csr_array(scipy.ndimage.gaussian_filter1d(np.eye(n), sigma, 0, mode="nearest", truncate=3))
        for n in sides
    )
    channels = eye_array(truth.matrix.shape[0] // (sides[0] * sides[1]))
    mixed = csr_array(kron(kron(across, along), channels), dtype=np.float32)
    # Direct light travels along as the imaginary part, so that both have the same entries.
    both = truth.with_data(truth.matrix.data + 1j * truth.direct_data)
    parts = []
    for start in range(0, mixed.shape[0], 1024):
        part = mixed[start : start + 1024] @ both
        whole = csr_array((part.data.real, part.indices, part.indptr), shape=part.shape)
        parts.append(thinned_in_steps(whole, np.ascontiguousarray(part.data.imag), 0.9995))
    matrix, direct_data = joined(parts)
    return replace(truth, matrix=matrix, direct_data=direct_data)


def vignetting(truth: Truth, strength: float) -> Truth:
    """Gain 1 - strength r^2, r from the middle to 1 in the corners; strength in [0, 1)."""
    y, x = (np.linspace(-1, 1, size) for size in truth.camera_shape[:2])
    gain = (1 - strength * np.add.outer(y**2, x**2) / 2).ravel().astype(np.float32)
    gain = np.repeat(gain, truth.matrix.shape[0] // gain.size)
    return truth.scaled(np.repeat(gain, np.diff(truth.matrix.indptr)))


def ambient(truth: Truth, level: float) -> NDArray[np.float32]:
    """Image of the room's light alone, (M,) float32; its mean is `level` times that under white."""
    white = np.asarray(truth.matrix.sum(axis=1), np.float64).reshape(*truth.camera_shape[:2], -1)
    # Room light comes from all sides and has no shadow edges, so the white image is blurred by six
    # camera pixels (standard deviation).
    smooth = scipy.ndimage.gaussian_filter(white, (6, 6, 0))
    return np.asarray(level * smooth.ravel(), np.float32)


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
