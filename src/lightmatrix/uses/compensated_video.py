"""`lm.compensate_video`: patterns for the frames of a video, each started from the one before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import PATTERNS
from lightmatrix.files.stacks import list_images
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.folder import write_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.ranges import check_number
from lightmatrix.reprs import short_repr
from lightmatrix.uses.compensation import USUAL_ITERATIONS, compensator
from lightmatrix.uses.images import Picture, wanted_samples
from lightmatrix.uses.loading import Transport

# Iterations for a frame that starts from the pattern of the frame before. In a picture that pans by
# a pixel a frame at 64 x 64, ten are within 0.05 dB of 25 from the start.
_FOLLOWING = 10


@dataclass(frozen=True, eq=False)
class CompensatedVideo:
    """The patterns for the frames of a video; made by `compensate_video`.

    Parameters
    ----------
    patterns : (K, rows, cols) float32
        In [0, 1].
    brightness, scale : float
        As in `Compensation`, the same for all frames, so that the video does not flicker.
    predicted_psnr : (K,) float64
        The predicted error of each frame in dB.
    reached : (K,) float64
        Share of camera samples that come close to what they should be.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> frames = np.stack([np.full((64, 64), grey) for grey in (0.2, 0.4)])
    >>> lm.compensate_video(lm.truth("metal").transport(), frames).patterns.shape
    (2, 64, 64)
    """

    patterns: NDArray[np.float32]
    brightness: float
    scale: float
    predicted_psnr: NDArray[np.float64]
    reached: NDArray[np.float64]

    __repr__ = short_repr

    def as_dict(self) -> dict[str, Any]:
        """Number of frames, brightness, scale, and the means over the frames; JSON-ready."""
        return {
            "frames": len(self.patterns),
            "brightness": self.brightness,
            "scale": self.scale,
            "predicted_psnr": float(self.predicted_psnr.mean()),
            "reached": float(self.reached.mean()),
        }


def compensate_video(
    transport: Transport,
    frames: str | Path | Sequence[Picture] | NDArray[Any],
    *,
    ambient: Picture | None = None,
    mask: Picture | None = None,
    brightness: float | None = None,
    gamma: float = 1.0,
    resize: bool = False,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> CompensatedVideo:
    """The patterns under which the camera sees the frames of a video.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it.
    frames : (K, rows, cols[, channels]) array, a sequence of images, or a folder of image files
        The wanted pictures; a folder is read in natural order.
    ambient, mask, brightness, gamma, resize
        As in `compensate`. The automatic brightness suits the whole video: each pixel at its
        brightest.
    output : str or Path, optional
        Folder of patterns to write, as `write_patterns` does.
    overwrite : bool
        Whether an existing folder of patterns may be replaced.
    progress : callable, optional
        Called with (done, total) frames.

    Returns
    -------
    CompensatedVideo

    Raises
    ------
    InputError
        As `compensate`; a frame may be black, all of them may not.
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> fading = [np.full((64, 64), grey) for grey in (0.1, 0.2, 0.3)]
    >>> video = lm.compensate_video(lm.truth("metal").transport(), fading, output="patterns")
    >>> lm.read_patterns("patterns").count
    3
    """
    if brightness is not None:
        hint = "use a number above 0, such as 0.7, or leave it out"
        check_number("a brightness", brightness, most=1e6, above=True, hint=hint)
    if output is not None:
        check_output(output, PATTERNS, overwrite=overwrite)
    pictures: Any = list_images(frames) if isinstance(frames, str | Path) else frames
    if not len(pictures):
        raise InputError("a video without frames", hint="give at least one frame")
    shared = compensator(transport, ambient=ambient, mask=mask)
    shared.light.check_single()
    shape = shared.light.camera_shape

    def samples(index: int) -> NDArray[np.float32]:
        picture = pictures[index]
        return wanted_samples(picture, shape, gamma=gamma, resize=resize, black=True)

    if brightness is None:
        brightest = samples(0)
        for index in range(1, len(pictures)):
            np.maximum(brightest, samples(index), out=brightest)
        brightness = shared.automatic_brightness(brightest)
    patterns = np.empty((len(pictures), *shared.light.matrices[0].projector_shape), np.float32)
    errors, reached = np.empty(len(pictures)), np.empty(len(pictures))
    scale, last, iterations = 0.0, None, USUAL_ITERATIONS
    for index in range(len(pictures)):
        found = shared.solve(samples(index), brightness, start=last, iterations=iterations)
        patterns[index], scale = found.pattern, found.scale
        errors[index], reached[index] = found.psnr, found.reachable.mean()
        last, iterations = found.pattern.ravel(), _FOLLOWING
        if progress is not None:
            progress(index + 1, len(pictures))
    if output is not None:
        write_patterns(output, ImagePatterns(patterns), overwrite=overwrite)
    return CompensatedVideo(patterns, brightness, scale, errors, reached)
