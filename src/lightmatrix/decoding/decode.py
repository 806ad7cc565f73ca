"""`lm.decode`: the correspondence of a capture under stripes, without an estimate of T."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposures import USUAL_NOISE
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.decoding.codes import Code, Codes, find_codes
from lightmatrix.decoding.reading import Reading, correlate, read_bits, refine
from lightmatrix.outputs.kinds import CORRESPONDENCE
from lightmatrix.outputs.writing import check_output
from lightmatrix.store.npz import write_correspondence
from lightmatrix.transport.correspondence import Correspondence

Progress = Callable[[int, int], None]
# A camera pixel sees the projector if its direct light exceeds this share of the clip level: five
# standard deviations of a decent camera's noise.
_LEAST_LIGHT = 5 * USUAL_NOISE
# Camera samples times frames that are decoded at a time: temporary arrays stay below 300 MB.
_AT_ONCE = 1 << 23


def decode(
    capture: Capture | str | Path,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Correspondence:
    """Decode a capture under stripes: Gray code, phase shifts, micro phase shifts, and others.

    The code is read from the patterns themselves. They may come in any order, with or without
    inverse, white and black patterns, along columns, rows, or both. Black and white codes are
    decoded bit by bit, any other by the best correlation with the samples; then the samples are
    explained as a mixture of two neighbouring projector pixels, for the place within the pixel.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture or its folder. Channels of a colour camera are added.
    output : str or Path, optional
        The file to write: .npz, which `triangulate` and `read_correspondence` read.
    overwrite : bool
        Whether an existing correspondence may be replaced.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Correspondence
        Pixel, place, confidence (the share of the samples' variance that the code explains), its
        uncertainty and the direct light of each camera pixel. Where the patterns vary along columns
        only, rows are -1 and NaN, and vice versa.

    Raises
    ------
    InputError
        If a pattern is no stripes, or the patterns of an axis show two of its pixels alike.
    OutputError
        If the file exists or cannot be written.

    References
    ----------
    Inokuchi et al. 1984 (Gray code); Mirdehghan, Chen & Kutulakos 2018 (correlation).

    Examples
    --------
    >>> import lightmatrix as lm
    >>> code = lm.make_patterns("graycode", (64, 64), inverse=True)
    >>> matches = lm.decode(lm.simulate("metal", code, exposure=0.2))
    >>> matches.pixel[20, 30].tolist()
    [20, 30]
    """
    if output is not None:
        check_output(output, CORRESPONDENCE, overwrite=overwrite)
    opened = open_capture(capture)
    codes = find_codes(opened.patterns)
    shape = opened.camera_shape
    channels = shape[2] if len(shape) == 3 else 1
    count = shape[0] * shape[1]
    pixel = np.full((count, 2), -1, np.int32)
    place = np.full((count, 2), np.nan, np.float32)
    uncertainty = np.full((count, 2), np.nan, np.float32)
    confidence, light = np.zeros(count, np.float32), np.zeros(count, np.float32)
    step = channels * max(1, _AT_ONCE // (channels * opened.count))
    for start, tile in opened.tiles(step):
        values, usable = _of_pixels(tile, channels)
        rows = slice(start // channels, start // channels + len(values))
        readings = {code.axis: _read(code, codes, values) for code in codes.codes}
        for reading in readings.values():
            usable &= (reading.pixel >= 0) & (reading.light > _LEAST_LIGHT)
        for axis, reading in readings.items():
            pixel[rows, axis] = np.where(usable, reading.pixel, -1)
            place[rows, axis] = np.where(usable, reading.place, np.nan)
            uncertainty[rows, axis] = np.where(usable, reading.uncertainty, np.nan)
        explained = np.min([reading.explained for reading in readings.values()], axis=0)
        confidence[rows] = np.where(usable, explained, 0)
        mean = np.mean([reading.light for reading in readings.values()], axis=0)
        light[rows] = np.where(usable, mean, 0)
        if progress is not None:
            progress(min(start + step, opened.rows), opened.rows)
    grid = (shape[0], shape[1])
    result = Correspondence(
        pixel.reshape(*grid, 2),
        place.reshape(*grid, 2),
        confidence.reshape(grid),
        uncertainty.reshape(*grid, 2),
        light.reshape(grid),
        opened.projector_shape,
    )
    if output is not None:
        write_correspondence(output, result, overwrite=overwrite)
    return result


def _of_pixels(tile: Samples, channels: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The samples of each pixel, (m, K), its channels added, and which pixels are not masked."""
    counted = tile.counted.reshape(-1, channels, tile.values.shape[1]).any(axis=(1, 2))
    values = np.asarray(tile.values, np.float32)
    if channels > 1:
        values = values.reshape(-1, channels, values.shape[1]).sum(axis=1)
    return values, np.asarray(counted)


def _read(code: Code, codes: Codes, values: NDArray[np.float32]) -> Reading:
    """What camera pixels with these samples (m, K) see along the axis of a code."""
    samples = np.ascontiguousarray(values[:, code.frames])
    if not code.bits:
        return refine(code, samples, correlate(code, samples))
    bright = samples.max(axis=1) if codes.white is None else values[:, codes.white]
    dark = samples.min(axis=1) if codes.black is None else values[:, codes.black]
    middle = np.asarray((bright + dark) / 2, np.float32)
    return refine(code, samples, read_bits(code, samples, middle))
