"""The exposure time that a camera wrote into a photograph."""

from __future__ import annotations

import warnings
from pathlib import Path

from PIL import Image

from lightmatrix.errors import MissingExtraError
from lightmatrix.files.raw import RAW, raw_library

# The tag of the EXIF directory, and that of the exposure time in it.
_EXIF, _EXPOSURE_TIME = 0x8769, 0x829A
# Seconds. A longer exposure is a damaged tag.
_LONGEST = 1e5


def exposure_time(path: str | Path) -> float | None:
    """Exposure time of a photograph in seconds; None if it does not say, or is damaged."""
    file = Path(path)
    try:
        seconds = _raw_seconds(file) if file.suffix.lower() in RAW else _exif_seconds(file)
    except MissingExtraError:
        raise
    # Image libraries raise nearly anything on damaged files.
    except Exception:
        return None
    return seconds if 0 < seconds < _LONGEST else None


def _raw_seconds(file: Path) -> float:
    with raw_library().imread(str(file)) as opened:
        return float(opened.other.shutter_speed)


def _exif_seconds(file: Path) -> float:
    with warnings.catch_warnings():
        # Pillow warns of unusual tags, which are of no interest here.
        warnings.simplefilter("ignore")
        with Image.open(file) as image:
            return float(image.getexif().get_ifd(_EXIF).get(_EXPOSURE_TIME) or 0)
