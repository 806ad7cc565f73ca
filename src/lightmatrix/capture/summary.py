"""Descriptions of a capture: a short summary, a full one for provenance, and a hash."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from lightmatrix.capture.frames import CutFrames
from lightmatrix.capture.reader import Reader
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import jsonable

# The number of different exposures that a summary lists; it counts the others.
_LISTED_EXPOSURES = 4


def summarize(patterns: PatternSet, reader: Reader) -> dict[str, Any]:
    """Number of frames, shapes, kind of patterns, levels and exposures, without decoding any."""
    exposures = np.unique(reader.exposures)
    listed = ", ".join(f"{exposure:g}" for exposure in exposures[:_LISTED_EXPOSURES])
    if len(exposures) > _LISTED_EXPOSURES:
        listed += f" and {len(exposures) - _LISTED_EXPOSURES} more"
    return {
        "frames": reader.frames.count,
        "camera": " x ".join(map(str, reader.camera_shape)),
        "projector": " x ".join(map(str, patterns.shape)),
        "patterns": type(patterns).__name__,
        "levels": str(reader.frames.dtype),
        "exposure": listed,
    }


def description(
    patterns: PatternSet, reader: Reader, bin_projector: tuple[int, int]
) -> dict[str, Any]:
    """Shapes of a capture and how it is read, JSON-ready; part of an estimate's provenance."""
    decoder = reader.decoder
    frames = reader.frames
    cropped = {"crop": frames.region.as_dict()} if isinstance(frames, CutFrames) else {}
    return {
        **cropped,
        "camera_shape": list(reader.camera_shape),
        "projector_shape": list(patterns.shape),
        "frames": reader.frames.count,
        "bin_camera": list(reader.block),
        "bin_projector": list(bin_projector),
        "clip": jsonable(decoder.clip),
        "black_level": jsonable(decoder.black_level),
        "black_frame": decoder.black_frame is not None,
        "exposure": jsonable(decoder.exposure),
        "response": decoder.response.name,
        "masked": int((~reader.valid).sum()),
    }


def digest(patterns: PatternSet, reader: Reader) -> str:
    """Hash of the patterns and of all samples, 16 hex digits."""
    hasher = hashlib.sha256(patterns.digest.encode())
    hasher.update(repr((reader.camera_shape, patterns.shape)).encode())
    for _, tile in reader.tiles():
        for array in (tile.values, tile.clipped, tile.clip_level, tile.weights):
            if array is not None:
                hasher.update(np.ascontiguousarray(array).tobytes())
    return hasher.hexdigest()[:16]
