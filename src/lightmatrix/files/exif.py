"""What a camera wrote into its photographs: how long it exposed."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image

_EXIF, _EXPOSURE_TIME = 0x8769, 0x829A


def exposure_time(path: str | Path) -> float | None:
    """Exposure time of a JPEG, PNG or TIFF photograph in seconds; None if it does not say."""
    try:
        with warnings.catch_warnings():
            # Of odd tags; what is wanted is there or not.
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                found = image.getexif().get_ifd(_EXIF).get(_EXPOSURE_TIME)
        seconds = 0.0 if found is None else float(found)
    # Image libraries raise nearly anything on damaged files.
    except Exception:
        return None
    return seconds if 0 < seconds < 1e5 else None
