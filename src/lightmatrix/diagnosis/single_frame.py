"""What one photograph reveals by itself; a live rig asks after each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.diagnosis.finding import Finding

# A frame is too bright if two thirds of its samples clip, as a whole capture is; it is dark if its
# brightest thousandth does not reach 8 raw levels above black. Both were chosen by hand.
_MOST_CLIPPED = 2 / 3
_FEWEST_LEVELS = 8


def check_frame(
    image: NDArray[Any],
    decoder: Decoder,
    *,
    index: int = 0,
    lit: bool = True,
    previous: NDArray[Any] | None = None,
) -> list[Finding]:
    """What is wrong with one photograph: too bright, too dark, or a copy of the one before.

    `image` holds raw levels, `index` is the number of the frame, `lit` tells whether its pattern is
    not black, and `previous` is the photograph before it, under another pattern.
    """
    findings = []
    decoded = decoder.decode(image.reshape(-1, 1), first_frame=index)
    clipped = float(decoded.clipped.mean())
    # Back to raw levels of this frame.
    floats = image.dtype.kind == "f"
    unit = 1.0 if floats else float(np.max(decoder.clip) - np.min(decoder.black_level))
    exposures = np.asarray(decoder.exposure)
    exposure = float(exposures[index] if exposures.ndim else exposures)
    bright = float(np.quantile(decoded.values, 0.999)) * unit * exposure
    if clipped > _MOST_CLIPPED:
        findings.append(
            Finding(
                "light",
                (index,),
                f"{100 * clipped:.0f} % of the frame is clipped",
                "expose shorter, or close the aperture",
            )
        )
    elif lit and not floats and bright < _FEWEST_LEVELS:
        findings.append(
            Finding(
                "frame",
                (index,),
                "the frame is dark, although its pattern is not",
                "is the projector on, the shutter open, the cap off?",
            )
        )
    if previous is not None and np.array_equal(image, previous):
        findings.append(
            Finding(
                "order",
                (index,),
                "the frame is the one before it, bit for bit",
                "the camera delivered an old frame: wait longer, or flush its buffers",
            )
        )
    return findings
