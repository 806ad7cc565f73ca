"""The white frame: a photograph under a white pattern, as linear samples."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lightmatrix.camera.camera_curve import Response
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.decoding import check_depth, make_decoder
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError
from lightmatrix.files.stacks import ImageStack

# A white frame is refused if its bright pixels are below this share of the clip level. Chosen by
# hand: so little is black level and noise rather than light.
_DARK = 0.02
# The bright pixels are those at this quantile of all.
_BRIGHT_QUANTILE = 0.99


def read_white_frame(path: str | Path, settings: ReadSettings) -> Samples:
    """The M samples of a photograph that do not clip without light, (M, 1), at exposure 1."""
    file = Path(path)
    if not file.exists() or file.is_dir():
        problem = "is a folder" if file.is_dir() else "no such file"
        raise InputError(
            f"{file}: {problem}", hint="give a photograph of a white pattern, a scene, or a T.npz"
        )
    stack = ImageStack.open([file])
    decoder = make_decoder(stack, replace(settings, response=settings.response or Response()))
    check_depth(stack, decoder)
    decoded = decoder.decode(stack.read(0).reshape(-1, 1))
    keep = slice(None) if decoder.hot is None else ~decoder.hot
    level = decoded.clip_level if decoded.clip_level.ndim == 1 else decoded.clip_level[keep]
    values = np.asarray(decoded.values[keep])
    bright = float(np.quantile(values, _BRIGHT_QUANTILE)) if values.size else 0.0
    if bright < _DARK:
        raise InputError(
            "the white frame is dark: its bright pixels are at "
            f"{100 * max(bright, 0):.1f} % of the clip level",
            hint="photograph the white pattern with a longer exposure; if the pixels show the "
            "black level, give --black",
        )
    return Samples(values, np.asarray(decoded.clipped[keep]), level)
