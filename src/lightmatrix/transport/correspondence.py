"""The correspondence: the projector pixel that each camera pixel sees most."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.ranges import check_sides, check_type, real_array
from lightmatrix.reprs import ShortRepr
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import HOW_TO_GIVE, TransportOperator

# Half width, in projector pixels, of the window around the strongest pixel. It is wide enough for a
# slightly defocused lens and narrow enough to exclude light that arrives by other paths. Chosen by
# hand.
REACH = 2
# Number of matrix entries that are handled at a time, so that temporary arrays stay below 1 GB.
_ENTRIES = 1 << 23


@dataclass(frozen=True, eq=False, repr=False)
class Correspondence(ShortRepr):
    """The projector pixel that each camera pixel sees most.

    Parameters
    ----------
    pixel : (rows, cols, 2) int32
        Row and column of the strongest projector pixel, counted from 0; -1 where a camera pixel
        sees none.
    place : (rows, cols, 2) float32
        The same to fractions of a pixel: the centre of the light within 5 x 5 pixels around it;
        NaN where a camera pixel sees none.
    confidence : (rows, cols) float32
        Share of the row's light, background included, that comes from this window, in [0, 1]: near
        1 if all light comes from one place, small if it comes from many, 0 if there is none.
    uncertainty : (rows, cols, 2) float32, optional
        Standard deviation of the place along rows and columns, in projector pixels.
    light : (rows, cols) float32, optional
        Light of the window in units of the clip level: direct light, under a white pattern.
    projector_shape : (rows, cols), optional
        The projector's pixels.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> matches = lm.correspondence(lm.truth("metal").transport())
    >>> matches.pixel[20, 30].tolist(), matches.confidence.shape
    ([20, 30], (64, 64))
    """

    pixel: NDArray[np.int32]
    place: NDArray[np.float32]
    confidence: NDArray[np.float32]
    uncertainty: NDArray[np.float32] | None = None
    light: NDArray[np.float32] | None = None
    projector_shape: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        grid = real_array("a confidence", self.confidence).shape
        for part in fields(self)[:-1]:
            if (given := getattr(self, part.name)) is None and part.default is None:
                continue
            values = real_array(part.name, given)
            wanted = grid if part.name in ("confidence", "light") else (*grid, 2)
            if len(grid) != 2 or values.shape != wanted:
                raise InputError(
                    f"{part.name} of shape {values.shape}, for photographs of shape {grid}",
                    hint="give (rows, cols) of confidence and light, and (rows, cols, 2) of others",
                )
            object.__setattr__(self, part.name, values)
        if self.projector_shape is not None:
            check_sides("a projector", self.projector_shape)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """The camera pixels that see the projector, (rows, cols)."""
        # Codes of columns only leave all rows unknown.
        return np.asarray((self.pixel >= 0).any(axis=-1))


def correspondence(transport: TransportOperator) -> Correspondence:
    """Find the projector pixel that each camera pixel sees most, with a confidence.

    Parameters
    ----------
    transport : LightTransport or StoredTransport
        T; the channels of a colour camera are added. A store is read block by block.

    Returns
    -------
    Correspondence
        Pixel, place to fractions of a pixel, and confidence of each camera pixel.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> matches = lm.correspondence(lm.truth("metal").transport())
    >>> [round(float(place), 1) for place in matches.place[20, 30]]
    [20.1, 29.8]
    """
    check_type("a light transport matrix", transport, TransportOperator, hint=HOW_TO_GIVE)
    camera, projector = transport.image_shapes
    channels = math.prod(camera[2:])
    parts: list[tuple[NDArray[Any], ...]] = []
    # A matrix on disk is read in steps of this many rows, those of 65,536 camera pixels.
    step = channels << 16
    for start in range(0, transport.shape[0], step):
        rows = transport.some_rows(start, min(start + step, transport.shape[0]))
        matrix, background = _of_pixels(rows.coefficients, rows.background, channels)
        parts += _strongest(matrix, background, projector[1], REACH)
    return _joined(parts, camera, projector)


def strongest_places(
    matrix: csr_array, background: NDArray[np.float64], shape: tuple[int, int],
    other_shape: tuple[int, int], reach: int = REACH,
) -> Correspondence:  # fmt: skip
    """The strongest place of each row of a matrix, whose columns are pixels of another device.

    Rows are the pixels of a device of `shape`, `background` (rows,) is light of each that has no
    place, and the window around the strongest pixel has 2 `reach` + 1 pixels along a side.
    """
    return _joined(_strongest(matrix, background, other_shape[1], reach), shape, other_shape)


def _joined(
    parts: Iterable[tuple[NDArray[Any], ...]], shape: tuple[int, ...], other_shape: tuple[int, ...]
) -> Correspondence:
    """The correspondence of a device of `shape` from what `_strongest` found of its rows."""
    pixel, place, confidence, light = map(np.concatenate, zip(*parts, strict=True))
    return Correspondence(
        pixel.reshape(*shape[:2], 2), place.reshape(*shape[:2], 2), confidence.reshape(shape[:2]),
        light=light.reshape(shape[:2]), projector_shape=(other_shape[0], other_shape[1]),
    )  # fmt: skip


def pixel_rows(transport: LightTransport) -> tuple[csr_array, NDArray[np.float64]]:
    """The sparse part of each camera pixel and the light of its background; channels are added."""
    channels = math.prod(transport.camera_shape[2:])
    return _of_pixels(transport.sparse, transport.background, channels)


def _of_pixels(
    sparse: csr_array, background: NDArray[Any], channels: int
) -> tuple[csr_array, NDArray[np.float64]]:
    faint = background.sum(axis=1, dtype=np.float64)
    if channels == 1:
        return sparse, faint
    samples = np.arange(len(faint))
    ones = np.ones(len(samples), np.float32)
    adding = csr_array((ones, (samples // channels, samples)))
    return csr_array(adding @ sparse), faint.reshape(-1, channels).sum(axis=1)


def _strongest(
    matrix: csr_array, background: NDArray[np.float64], width: int, reach: int
) -> Iterator[tuple[NDArray[Any], ...]]:
    """The strongest pixel, its place, its confidence and the light around it, of some rows each."""
    step = max(1, _ENTRIES // max(1, matrix.nnz // len(background)))
    for start in range(0, len(background), step):
        rows = slice(start, start + step)
        yield _strongest_of_some(csr_array(matrix[rows]), background[rows], width, reach)


def _strongest_of_some(
    matrix: csr_array, background: NDArray[np.float64], width: int, reach: int
) -> tuple[NDArray[Any], ...]:
    """What `_strongest` yields, of all rows at once."""
    count = int(matrix.shape[0])
    owner = np.repeat(np.arange(count), np.diff(matrix.indptr))
    # Some estimates allow negative light, which does not count.
    light = np.maximum(matrix.data, 0).astype(np.float64)
    peak = np.zeros(count)
    np.maximum.at(peak, owner, light)
    strongest = np.full(count, -1, np.int64)
    at_peak = (light == peak[owner]) & (light > 0)
    # In reverse order, so that the first of several equal pixels stays.
    strongest[owner[at_peak][::-1]] = matrix.indices[at_peak][::-1]
    valid = strongest >= 0
    pixel = np.where(valid[:, None], np.stack(np.divmod(strongest, width), axis=1), -1)
    distance = np.stack(np.divmod(matrix.indices.astype(np.int64), width), axis=1) - pixel[owner]
    near = light * (np.abs(distance) <= reach).all(axis=1)
    window = np.bincount(owner, near, count).astype(np.float64)
    total = np.bincount(owner, light, count) + np.maximum(background, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        offset = [np.bincount(owner, near * distance[:, axis], count) / window for axis in (0, 1)]
        confidence = np.where(valid, window / total, 0)
    place = np.where(valid[:, None], pixel + np.stack(offset, axis=1), np.nan)
    single = (values.astype(np.float32) for values in (place, confidence, window))
    return pixel.astype(np.int32), *single
