"""What a capture is made of, as it is read from disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.capture.frames import Frames
from lightmatrix.patterns.pattern_set import PatternSet


@dataclass(frozen=True, eq=False)
class CaptureParts:
    """Patterns, frames and how to read these.

    Parameters
    ----------
    patterns : PatternSet
    frames : Frames
    decoder : Decoder
    mask : shape of a frame, bool, optional
    provenance : mapping
    """

    patterns: PatternSet
    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
