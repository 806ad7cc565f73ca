"""`lm.decode`: the correspondence of a capture under stripes, without an estimate of T."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.check.refusals import refuse_unordered, refuse_unusable, warn_of
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError, warn
from lightmatrix.files.kinds import CORRESPONDENCE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.codes import find_codes, read_code
from lightmatrix.progress import Progress
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.npz import write_correspondence


def decode(
    capture: Capture | str | Path,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    check: bool = True,
    progress: Progress | None = None,
) -> Correspondence:
    """Decode a capture under stripes: Gray code, phase shifts, micro phase shifts, and others.

    The code is read from the patterns themselves. They may come in any order, with or without
    inverse, white and black patterns, along columns, rows, or both. Black and white codes are
    decoded bit by bit, any other by the best correlation with the samples; then the samples are
    explained as a mixture of two neighbouring projector pixels, for the place within the pixel. A
    code without its finest bits places camera pixels to blocks of projector pixels.

    Parameters
    ----------
    capture : Capture, str or Path
        The capture or its folder. Channels of a colour camera are added.
    output : str or Path, optional
        The file to write: .npz, which `triangulate` and `read_correspondence` read.
    overwrite : bool
        Whether an existing correspondence may be replaced.
    check : bool
        Whether to refuse photographs that do not follow their patterns, and to warn of what else
        `lm.check` finds.
    progress : callable, optional
        Called with (done, total) camera samples.

    Returns
    -------
    Correspondence
        Pixel, place, confidence, uncertainty of the place and direct light of each camera pixel.
        The confidence is the share of the samples' variance that the code explains, less where
        clipped samples leave the place open; where no neighbour sees a place nearby, it is 0, and
        half where one does. Of patterns along columns only, rows are -1 and NaN, and vice versa.

    Warns
    -----
    LightMatrixWarning
        For each finding of `lm.check`, and if many places contradict those of their neighbours.

    Raises
    ------
    InputError
        If a pattern is no stripes, the patterns of an axis show two of its pixels alike that do not
        lie side by side, the photographs do not follow the patterns, or no camera pixel sees the
        projector.
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
    check_output(output, CORRESPONDENCE, overwrite=overwrite)
    opened = open_capture(capture)
    codes = find_codes(opened.patterns)
    blocks = [code.block for code in codes.codes]
    if max(blocks, default=1) > 1:
        warn(f"the code numbers blocks of {' and '.join(map(str, blocks))} projector pixels")
    refuse_unusable(opened)
    if check:
        # What limits an estimate of T is no fault here.
        limits = ("stripes", "patterns", "linearity", "unseen")
        warn_of(each for each in refuse_unordered(opened) if each.kind not in limits)
    shape = opened.camera_shape
    channels = shape[2] if len(shape) == 3 else 1
    count = shape[0] * shape[1]
    place, uncertainty = np.full((2, count, 2), np.nan, np.float32)
    confidence, light = np.zeros((2, count), np.float32)
    # Temporary arrays of this many camera samples times frames stay below 300 MB.
    step = channels * max(1, (1 << 23) // (channels * opened.count))
    for start, tile in opened.tiles(step):
        usable = np.asarray(tile.counted.reshape(-1, channels, opened.count).any(axis=(1, 2)))
        values = np.asarray(tile.values, np.float32)
        if channels > 1:
            values = values.reshape(-1, channels, opened.count).sum(axis=1)
        rows = slice(start // channels, start // channels + len(values))
        clipped = np.asarray(tile.clipped.reshape(len(values), channels, -1).any(axis=1))
        readings = {code.axis: read_code(codes, code, values, clipped) for code in codes.codes}
        # A camera pixel sees the projector if its direct light exceeds five standard deviations of
        # a decent camera's noise, and noise alone resembles a code as well once in a thousand.
        usable &= sum(reading.evidence for reading in readings.values()) > np.log(1000)
        for reading in readings.values():
            usable &= np.isfinite(reading.place) & (reading.light > 5 * USUAL_NOISE)
        for axis, reading in readings.items():
            place[rows, axis] = np.where(usable, reading.place, np.nan)
            uncertainty[rows, axis] = np.where(usable, reading.uncertainty, np.nan)
        explained = np.min([reading.explained for reading in readings.values()], axis=0)
        confidence[rows] = np.where(usable, explained, 0)
        mean = np.mean([reading.light for reading in readings.values()], axis=0)
        light[rows] = np.where(usable, mean, 0)
        if progress is not None:
            progress(min(start + step, opened.rows), opened.rows)
    if not light.any():
        raise InputError(
            "no camera pixel sees the projector",
            hint="compare a photograph under white with one under black; are these the "
            "photographs of these patterns, in their order?",
        )
    grid = (shape[0], shape[1])
    places = place.reshape(*grid, 2)
    agreeing = agreement(places, uncertainty.reshape(*grid, 2))
    result = Correspondence(
        np.where(np.isfinite(places), np.rint(places), -1).astype(np.int32), places,
        confidence.reshape(grid) * agreeing, uncertainty.reshape(*grid, 2), light.reshape(grid),
        opened.projector_shape,
    )  # fmt: skip
    contradicted = float(1 - agreeing[result.valid].mean())
    # At most a few per cent do in intact captures with occlusions and noise.
    if check and contradicted > 0.1:
        warn(
            f"{100 * contradicted:.0f} % of the decoded places contradict those of their "
            "neighbours\n  are all photographs there, in the order of their patterns? Did "
            "something move, or are the stripes too fine for the camera?"
        )
    if output is not None:
        write_correspondence(output, result, overwrite=overwrite)
    return result


def agreement(place: NDArray[np.float32], uncertainty: NDArray[np.float32]) -> NDArray[np.float32]:
    """Whether two neighbours of each camera pixel see places nearby (1), one (0.5) or none (0).

    Places and uncertainties are (rows, cols, 2), NaN where they are unknown. Neighbours without a
    place contradict nothing.
    """
    rows, cols = place.shape[:2]
    padded = np.pad(place, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    around = [padded[a : a + rows, b : b + cols] for a, b in ((0, 1), (2, 1), (1, 0), (1, 2))]
    steps = np.abs(np.stack(around) - place)
    known = np.isfinite(steps)
    coded = known.any(axis=(0, 1, 2))
    # Neighbours see the next places, or those a few steps on; at edges of objects two of four do.
    usual = [np.median(steps[..., axis][known[..., axis]]) if coded[axis] else 0 for axis in (0, 1)]
    far = steps > 2 + 4 * np.array(usual) + 3 * uncertainty
    contradicting = far.any(axis=-1).sum(axis=0)
    return np.clip((4 - contradicting) / 2, 0, 1).astype(np.float32)
