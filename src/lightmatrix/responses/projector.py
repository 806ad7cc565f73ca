"""The projector's response from photographs of a ramp: each shows one grey value all over."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response, range_end
from lightmatrix.capture.exposures import lit_samples, share_of_white
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import PICTURE, RESPONSE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.responses.photographs import Photographs, draw_projector_response, open_photographs

# The fewest photographs of a ramp; a curve with a bend needs as many.
_FEWEST = 5
_WHITE = 255
# The projector lights the scene if so many samples are lit, and white is above black by this share
# of the clip level.
_FEWEST_LIT, _VISIBLE = 20, 0.02


def projector_response(
    photographs: Photographs,
    levels: Sequence[float] | NDArray[Any] | None = None,
    *,
    response: Response | str | None = None,
    clip: float | None = None,
    output: str | Path | None = None,
    picture: str | Path | None = None,
    overwrite: bool = False,
) -> ProjectorResponse:
    """Measure a projector's response, as `lightmatrix response --projector` does.

    Parameters
    ----------
    photographs : str, Path or array
        At least 5 photographs at one exposure, each of one grey value all over the projector: a
        folder, a stack, or (K, rows, cols[, 3]) levels.
    levels : (K,), optional
        The grey values, whole numbers increasing from 0 to 255. None: evenly spaced.
    response : Response or str, optional
        The camera's response, see `Response.parse`. None: linear.
    clip : float, optional
        Raw level at which the camera clips. None: the end of the range of the files, or of the
        camera's response.
    output : str or Path, optional
        A .json file of the curve to write.
    picture : str or Path, optional
        A .png picture of the curve to write.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    ProjectorResponse

    Raises
    ------
    InputError
        If photographs cannot be read, grey values do not fit them, or there is too little light.
    OutputError
        If a file cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> light = np.linspace(0, 1, 9)[:, None, None] ** 1.8 * np.full((9, 10, 10), 0.8)
    >>> measured = lm.projector_response(np.rint(250 * light + 5).astype(np.uint8))
    >>> round(measured.gamma, 1)
    1.8
    """
    for path, kind in ((output, RESPONSE), (picture, PICTURE)):
        if path is not None:
            check_output(path, kind, overwrite=overwrite)
    frames = open_photographs(photographs)
    grey = _grey(levels, frames.count)
    camera = response if isinstance(response, Response) else Response.parse(response or "linear")
    scale = camera.full_scale or range_end(frames.dtype)
    ceiling = float(camera.linearise(np.array((clip or scale) / scale)))

    def light(index: int) -> NDArray[np.float64]:
        return camera.linearise(frames.read(index) / scale)

    black, white = light(0), light(frames.count - 1)
    lit = lit_samples(white, black, ceiling)
    if lit.sum() < _FEWEST_LIT or np.quantile(white - black, 0.99) < _VISIBLE * ceiling:
        raise InputError(
            f"{frames.name(frames.count - 1)} has only {int(lit.sum())} pixels that the projector "
            "lights and that do not clip",
            hint="photograph the projected picture so that white is bright and does not clip, the "
            "darkest grey value first",
        )
    shares = np.array([share_of_white(light(k), white, black, lit) for k in range(frames.count)])
    falls = np.flatnonzero(np.diff(shares) < -_VISIBLE)
    if len(falls):
        k = int(falls[0])
        raise InputError(
            f"{frames.name(k + 1)} is darker than {frames.name(k)}, though its grey value is "
            f"{grey[k + 1]} after {grey[k]}",
            hint="give --levels in the order of the photographs, from 0 to 255",
        )
    measured = ProjectorResponse.of_light(grey, shares)
    if output is not None:
        measured.save(output, overwrite=overwrite)
    if picture is not None:
        draw_projector_response(measured).write(picture, overwrite=overwrite)
    return measured


def _grey(levels: Sequence[float] | NDArray[Any] | None, count: int) -> NDArray[np.int64]:
    if count < _FEWEST:
        raise InputError(
            f"{count} photographs of grey values", hint=f"take {_FEWEST} at least, better 17"
        )
    if levels is None:
        return np.rint(np.linspace(0, _WHITE, count)).astype(np.int64)
    grey = np.asarray(levels, np.float64)
    if grey.shape != (count,):
        raise InputError(
            f"{grey.size} grey values for {count} photographs",
            hint="give one for each, in the order of the photographs",
        )
    whole = (grey == np.rint(grey)).all()
    if not whole or grey[0] != 0 or grey[-1] != _WHITE or (np.diff(grey) <= 0).any():
        raise InputError(
            f"grey values from {grey[0]:g} to {grey[-1]:g}",
            hint="give whole numbers that increase from 0 to 255, the photographs likewise",
        )
    return grey.astype(np.int64)
