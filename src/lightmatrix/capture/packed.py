"""Packed captures: all frames in one array of Zarr v3, chunked by tiles of camera pixels.

A tile of camera pixels is read without the rest of the frames. docs/scale.md documents the format;
`packing.py` writes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.frames import CaptureParts
from lightmatrix.capture.settings import ReadSettings, parse_description
from lightmatrix.files.kinds import PACKED_CAPTURE
from lightmatrix.files.reading import check_image_size
from lightmatrix.files.zarr_arrays import CHUNK, HEADER, StoredArray, as_damage_error, read_group
from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.making import remake_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.reprs import short_repr
from lightmatrix.resources.memory import check_memory

# The attributes of every packed capture state its format and version; others are refused.
FORMAT, VERSION = "lightmatrix-packed-capture", 1
# The names of the arrays in the group.
FRAMES, BITS, LEVELS, BLACK, MASK, CURVE = (
    "frames",
    "pattern_bits",
    "pattern_levels",
    "black_frame",
    "mask",
    "response_curve",
)
_REMEDY = "restore it, or pack the capture again"
# The keys of the group's attributes that capture.json does not have, or in another form.
_OWN_KEYS = {
    "format", "version", "output", "response", "names", "patterns", "black_exposure",
    "clip_assumed",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PackedFrames:
    """Frames `index` (K',) of a packed capture, read a tile of camera pixels at a time.

    `array` has the raw levels, (K, rows, cols[, channels]), of which the pixels in `rows` and
    `cols` count. A chunk holds all frames of some camera rows, or of a part of one.
    """

    array: StoredArray
    names: tuple[str, ...]
    index: NDArray[np.int64]
    rows: slice
    cols: slice
    # The strip of chunks that was read last. Tiles are smaller than it, and follow each other.
    _last: dict[int, NDArray[Any]] = field(default_factory=dict, repr=False)

    __repr__ = short_repr

    @property
    def count(self) -> int:
        return len(self.index)

    @property
    def shape(self) -> tuple[int, ...]:
        rows, cols = self.rows, self.cols
        return rows.stop - rows.start, cols.stop - cols.start, *self.array.shape[3:]

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        """One frame, for which the chunks of all frames are decompressed."""
        k = int(self.index[index])
        with as_damage_error(self.array.place.parent, _REMEDY):
            return self.array.read(slice(k, k + 1), self.rows, self.cols)[0]

    def name(self, index: int) -> str:
        """The name of the frame before it was packed."""
        return self.names[self.index[index]]

    def select(self, index: Sequence[int]) -> PackedFrames:
        return replace(self, index=self.index[list(index)], _last={})

    def part(self, rows: slice, cols: slice) -> PackedFrames:
        top, left = self.rows.start, self.cols.start
        rows = slice(top + rows.start, top + rows.stop)
        return replace(self, rows=rows, cols=slice(left + cols.start, left + cols.stop), _last={})

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        width = int(np.prod(self.shape[1:]))
        levels = np.empty((stop - start, self.count), self.dtype)
        top, end = self.rows.start + start // width, self.rows.start - (-stop // width)
        height = self.array.chunks[1]
        for number in range(top // height, -(-end // height)):
            strip = self._strip(number)
            # The strip's first sample, counted within the rectangle.
            first = (max(number * height, self.rows.start) - self.rows.start) * width
            low, high = max(start, first), min(stop, first + strip.shape[1])
            levels[low - start : high - start] = strip[:, low - first : high - first].T
        return levels

    def _strip(self, number: int) -> NDArray[Any]:
        """Levels of all frames in a row of chunks, as far as it lies in the rectangle, (K', n)."""
        strip = self._last.get(number)
        if strip is None:
            height = self.array.chunks[1]
            rows = slice(
                max(number * height, self.rows.start), min((number + 1) * height, self.rows.stop)
            )
            with as_damage_error(self.array.place.parent, _REMEDY):
                read = self.array.read(slice(None), rows, self.cols)
            strip = read.reshape(len(read), -1)
            if not np.array_equal(self.index, np.arange(len(strip))):
                strip = strip[self.index]
            self._last.clear()
            self._last[number] = strip
        return strip


def is_packed(place: Path) -> bool:
    """Whether a folder is a Zarr group rather than a plain capture folder."""
    return (place / HEADER).is_file()


def read_packed(place: Path) -> CaptureParts:
    """Open a packed capture: reads and checks everything but the frames."""
    hint = "give a capture folder, or what `lightmatrix pack` made of one"
    attributes = read_group(place, PACKED_CAPTURE.name, FORMAT, VERSION, hint)
    with as_damage_error(place, _REMEDY):
        shared = {key: value for key, value in attributes.items() if key not in _OWN_KEYS}
        if shared.keys() & {"black", "mask", "projector_response", "mosaic"}:
            raise ValueError("it names other files")
        description = parse_description(place / HEADER, shared)
        names, shape = attributes.get("names"), description.camera_shape
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError("its frames have no names")
        if shape is None or not names:
            raise ValueError("it has no frames")
        check_image_size(place, shape)
        count, channels = len(names), math.prod(shape[2:])
        # All frames of a pixel lie in one chunk, however many there are.
        array = StoredArray.open(place / FRAMES, max(CHUNK, count * channels))
        if array.shape != (count, *shape):
            raise ValueError(f"its frames have shape {array.shape}")
        if array.dtype not in (np.uint8, np.uint16, np.float32) or array.chunks[0] != count:
            raise ValueError(f"its frames are {array.dtype} in chunks of {array.chunks[0]} frames")
        every, rows, cols = np.arange(count), slice(0, shape[0]), slice(0, shape[1])
        frames = PackedFrames(array, tuple(names), every, rows, cols)
        decoder = _decoder(place, attributes, description.settings, frames)
        patterns = _patterns(place, attributes, count)
        if description.projector_shape != patterns.shape:
            raise ValueError(f"its patterns are {patterns.shape}")
        mask = _array(place, MASK, frames.shape, "b")
    return CaptureParts(patterns, frames, decoder, mask, dict(description.provenance))


def _decoder(
    place: Path, attributes: Mapping[str, Any], settings: ReadSettings, frames: PackedFrames
) -> Decoder:
    """The decoder of the frames, with its response and its black frame."""
    top = float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else np.inf
    clip, full_scale = settings.clip, settings.full_scale
    if clip is None or isinstance(clip, str) or full_scale is None or not full_scale <= top:
        raise ValueError("it does not say its clip level, or a full scale that no image has")
    name, black_exposure = attributes.get("response"), attributes.get("black_exposure")
    if not isinstance(name, str):
        raise ValueError("its response has no name")
    if black_exposure is not None and type(black_exposure) not in (int, float):
        raise ValueError("the exposure of its black frame is no number")
    response = Response(name=name)
    curve = _array(place, CURVE, None, "f")
    if curve is not None:
        if curve.ndim != 2 or len(curve) != 2 or curve.shape[1] < 2:
            raise ValueError("the curve of its response has no points")
        levels, light = curve.astype(np.float64)
        inside = curve.min() >= 0 and curve.max() <= 1
        if not (inside and (np.diff(levels) > 0).all() and (np.diff(light) >= 0).all()):
            raise ValueError("the curve of its response does not rise from 0 to 1")
        response = Response(levels, light, name)
    elif name not in ("linear", AUTOMATIC):
        raise ValueError(f"the curve of its response {name[:60]!r} is missing")
    black = _array(place, BLACK, frames.shape, "uf")
    decoder = Decoder(
        clip,
        full_scale,
        0.0 if settings.black_level is None else settings.black_level,
        response,
        settings.exposure,
        None if black is None else black.ravel(),
        black_exposure,
        attributes.get("clip_assumed") is True,
    )
    decoder.check_count(frames.count)
    return decoder


def _patterns(place: Path, attributes: Mapping[str, Any], count: int) -> PatternSet:
    """The set that made the patterns, if it still makes the same; else the patterns as stored."""
    entry = attributes.get("patterns")
    description = entry.get("description") if isinstance(entry, dict) else None
    if not isinstance(description, dict):
        raise ValueError("its patterns are not described")
    shape = attributes["projector_shape"]
    rows, cols = shape
    check_image_size(place, (rows, cols))
    if (place / LEVELS).exists():
        levels = _array(place, LEVELS, (count, rows, cols), "f")
        assert levels is not None
        return ImagePatterns(levels)
    bits = _array(place, BITS, (count, (rows * cols + 7) // 8), "u")
    if bits is None or bits.dtype != np.uint8:
        raise ValueError("its patterns are missing")
    if rows * cols % 8 and (bits[:, -1] >> (rows * cols % 8)).any():
        raise ValueError("its patterns have bits beyond their last pixel")
    stored = BitPatterns((rows, cols), bits)
    if description.get("count", count) != count or description.get("shape") != shape:
        raise ValueError("the description of its patterns is of others")
    made = remake_patterns(description)
    if made is None or made.count != count or made.shape != (rows, cols):
        return stored
    remade = made.as_bits()
    return made if remade is not None and np.array_equal(remade, bits) else stored


def _array(
    place: Path, name: str, shape: tuple[int, ...] | None, kinds: str
) -> NDArray[Any] | None:
    """One of the small arrays, read whole, of a given shape or any; None if there is none."""
    if not (place / name).exists():
        return None
    array = StoredArray.open(place / name)
    if shape not in (None, array.shape) or array.dtype.kind not in kinds:
        raise ValueError(f"its {name} is {array.dtype} of shape {array.shape}")
    check_memory(place, array.bytes)
    values = array.read()
    if array.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"its {name} is not finite")
    return values
