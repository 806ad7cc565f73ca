"""Which projector pixel each camera pixel sees most: what users of structured light look for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.transport.matrix import LightTransport

# Half width of the window around the strongest projector pixel: wide enough for a lens that is a
# little out of focus, narrow enough to leave out what arrives by other paths.
REACH = 2
# Entries looked at together, so that memory stays bounded.
_ENTRIES = 1 << 23


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The projector pixel that each camera pixel sees most.

    Parameters
    ----------
    pixel : (rows, cols, 2) int32
        Row and column of the strongest projector pixel, counted from 0; -1 where a camera pixel
        sees none.
    place : (rows, cols, 2) float32
        The same to fractions of a pixel: the centre of the light within a window of 5 x 5 around
        it; NaN where there is none.
    confidence : (rows, cols) float32
        Share of the row's light, background included, that comes from this window, in [0, 1]:
        near 1 where all light comes from one place, small where it comes from many or from
        everywhere, 0 where there is none.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.correspondence(lm.truth("metal").transport())
    >>> found.pixel[20, 30].tolist(), found.confidence.shape
    ([20, 30], (64, 64))
    """

    pixel: NDArray[np.int32]
    place: NDArray[np.float32]
    confidence: NDArray[np.float32]

    @property
    def found(self) -> NDArray[np.bool_]:
        """Camera pixels that see the projector at all, (rows, cols)."""
        return self.pixel[..., 0] >= 0

    def levels(self) -> NDArray[np.uint16]:
        """As a picture of three channels for a 16-bit PNG.

        Returns
        -------
        (rows, cols, 3) uint16
            Column and row of the strongest projector pixel, counted from 0, and the confidence
            from 0 to 65535, which is 0 only where a camera pixel sees no projector pixel.
        """
        shown = np.zeros((*self.confidence.shape, 3), np.uint16)
        shown[..., 0] = np.maximum(self.pixel[..., 1], 0)
        shown[..., 1] = np.maximum(self.pixel[..., 0], 0)
        shown[..., 2] = np.rint(self.confidence.clip(0, 1) * 65535)
        # However little was found, it is told from nothing.
        shown[..., 2] = np.maximum(shown[..., 2], self.found)
        return shown


def correspondence(transport: LightTransport) -> Correspondence:
    """Find the projector pixel that each camera pixel sees most, and how far to trust it.

    Parameters
    ----------
    transport : LightTransport
        T; the channels of a colour camera are added up.

    Returns
    -------
    Correspondence
        Pixel, place to fractions of a pixel, and confidence of each camera pixel.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.correspondence(lm.truth("metal").transport())
    >>> [round(float(place), 1) for place in found.place[20, 30]]
    [20.1, 29.8]
    """
    matrix, background = _pixels(transport)
    count, (_, width) = len(background), transport.projector_shape
    pixel = np.full((count, 2), -1, np.int32)
    place = np.full((count, 2), np.nan, np.float32)
    confidence = np.zeros(count, np.float32)
    per_row = max(1, matrix.nnz // max(1, count))
    step = max(1, _ENTRIES // per_row)
    for start in range(0, count, step):
        part = csr_array(matrix[start : start + step])
        rows = slice(start, start + part.shape[0])
        pixel[rows], place[rows], confidence[rows] = _strongest(part, background[rows], width)
    shape = transport.camera_shape[:2]
    return Correspondence(
        pixel.reshape(*shape, 2), place.reshape(*shape, 2), confidence.reshape(shape)
    )


def _pixels(transport: LightTransport) -> tuple[csr_array, NDArray[np.float64]]:
    """Sparse part of each camera pixel, and the light of its background; channels added up."""
    background = transport.background.sum(axis=1, dtype=np.float64)
    if len(transport.camera_shape) == 2:
        return transport.sparse, background
    channels = transport.camera_shape[2]
    pixels = len(background) // channels
    samples = np.arange(len(background))
    adding = csr_array(
        (np.ones(len(samples), np.float32), (samples // channels, samples)),
        shape=(pixels, len(samples)),
    )
    return csr_array(adding @ transport.sparse), background.reshape(pixels, channels).sum(axis=1)


def _strongest(
    matrix: csr_array, background: NDArray[np.float64], width: int
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Strongest pixel, place and confidence of some rows."""
    count = int(matrix.shape[0])
    owner = np.repeat(np.arange(count), np.diff(matrix.indptr))
    # Negative light, which some estimates allow, is none.
    light = np.maximum(matrix.data, 0).astype(np.float64)
    peak = np.zeros(count)
    np.maximum.at(peak, owner, light)
    strongest = np.full(count, -1, np.int64)
    at_peak = (light == peak[owner]) & (light > 0)
    # From the last to the first, so that the first of several that are alike is kept.
    strongest[owner[at_peak][::-1]] = matrix.indices[at_peak][::-1]
    found = strongest >= 0
    pixel = np.where(found[:, None], np.stack(np.divmod(strongest, width), axis=1), -1)
    away = np.stack(np.divmod(matrix.indices.astype(np.int64), width), axis=1) - pixel[owner]
    near = light * (np.abs(away) <= REACH).all(axis=1)
    window = np.bincount(owner, near, count)
    total = np.bincount(owner, light, count) + np.maximum(background, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        offset = [np.bincount(owner, near * away[:, axis], count) / window for axis in (0, 1)]
        confidence = np.where(found, window / total, 0)
    place = np.where(found[:, None], pixel + np.stack(offset, axis=1), np.nan)
    return pixel.astype(np.int32), place.astype(np.float32), confidence.astype(np.float32)
