"""Packed captures: all frames in one array of Zarr v3, chunked by tiles of camera pixels.

A tile of camera pixels is read without the rest of the frames. docs/scale.md documents the format;
`packing.py` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.decoding import CaptureParts
from lightmatrix.capture.settings import KEYS, Description, ReadSettings, parse_description
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import PACKED_CAPTURE, STORE
from lightmatrix.files.reading import check_image_size
from lightmatrix.files.zarr_arrays import (
    CHUNK,
    HEADER,
    StoredArray,
    as_damage_error,
    read_attributes,
)
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
# The keys of the group's attributes that capture.json has too, with the same kinds and ranges.
_SHARED_KEYS = KEYS - {
    "format", "version", "black", "mask", "response", "projector_response", "mosaic",
}  # fmt: skip
_KEYS = _SHARED_KEYS | {
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
        return replace(self, rows=_within(self.rows, rows), cols=_within(self.cols, cols), _last={})

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
    attributes = read_attributes(place)
    if attributes.get("format") != FORMAT:
        output = attributes.get("output")
        kind = output.get("kind") if isinstance(output, dict) else None
        if kind == STORE.name:
            raise InputError(
                f"{place}: is a {STORE.name}, not a capture",
                hint="give the capture that it was estimated from",
            )
        raise InputError(
            f"{place}: is not a {PACKED_CAPTURE.name}",
            hint="give a capture folder, or what `lightmatrix pack` made of one",
        )
    # True and 1.0 equal 1, but are no versions.
    if type(attributes.get("version")) is not int or attributes["version"] != VERSION:
        raise InputError(
            f"{place}: has format version {str(attributes.get('version'))[:20]}, this lightmatrix "
            f"reads {VERSION}",
            hint="update lightmatrix, or pack the capture again",
        )
    with as_damage_error(place, _REMEDY):
        unknown = sorted(set(attributes) - _KEYS)
        if unknown:
            raise ValueError(f"does not know {str(unknown[0])[:60]!r}")
        description = parse_description(
            place / HEADER, {k: v for k, v in attributes.items() if k in _SHARED_KEYS}
        )
        frames = _frames(place, attributes, description)
        decoder = _decoder(place, attributes, description.settings, frames)
        decoder.check_count(frames.count)
        patterns = _patterns(place, attributes, frames.count)
        if description.projector_shape != patterns.shape:
            raise ValueError(f"its patterns are {patterns.shape}")
        mask = _array(place, MASK, frames.shape, "b")
    return CaptureParts(patterns, frames, decoder, mask, dict(description.provenance))


def _frames(place: Path, attributes: Mapping[str, Any], description: Description) -> PackedFrames:
    names = attributes.get("names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("its frames have no names")
    shape = description.camera_shape
    if shape is None or not names:
        raise ValueError("it has no frames")
    check_image_size(place, shape)
    channels = shape[2] if len(shape) == 3 else 1
    # All frames of a pixel lie in one chunk, however many there are.
    array = StoredArray.open(place / FRAMES, max(CHUNK, len(names) * channels))
    if array.shape != (len(names), *shape):
        raise ValueError(f"its frames have shape {array.shape}")
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"its frames are {array.dtype}")
    if array.chunks[0] != len(names):
        raise ValueError("its chunks do not hold all frames")
    every = np.arange(len(names))
    return PackedFrames(array, tuple(names), every, slice(0, shape[0]), slice(0, shape[1]))


def _decoder(
    place: Path, attributes: Mapping[str, Any], settings: ReadSettings, frames: PackedFrames
) -> Decoder:
    clip, full_scale = settings.clip, settings.full_scale
    top = float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else np.inf
    if clip is None or full_scale is None or not full_scale <= top:
        raise ValueError("it does not say its clip level, or a full scale that no image has")
    black_exposure = attributes.get("black_exposure")
    if black_exposure is not None and type(black_exposure) not in (int, float):
        raise ValueError("the exposure of its black frame is no number")
    black = _array(place, BLACK, frames.shape, "uf")
    return Decoder(
        clip,
        full_scale,
        0.0 if settings.black_level is None else settings.black_level,
        _response(place, attributes),
        settings.exposure,
        None if black is None else black.ravel(),
        black_exposure,
        attributes.get("clip_assumed") is True,
    )


def _response(place: Path, attributes: Mapping[str, Any]) -> Response:
    name = attributes.get("response")
    if not isinstance(name, str):
        raise ValueError("its response has no name")
    if not (place / CURVE).exists():
        if name not in (Response().name, AUTOMATIC):
            raise ValueError(f"the curve of its response {name[:60]!r} is missing")
        return Response(name=name)
    curve = StoredArray.open(place / CURVE)
    if len(curve.shape) != 2 or curve.shape[0] != 2 or curve.shape[1] < 2:
        raise ValueError("the curve of its response has no points")
    check_memory(place, curve.bytes)
    levels, light = curve.read().astype(np.float64)
    rising = (np.diff(levels) > 0).all() and (np.diff(light) >= 0).all()
    ends = (levels[0] >= 0, levels[-1] <= 1, light[0] >= 0, light[-1] <= 1)
    # The comparisons are false for NaN.
    if not (rising and all(ends)):
        raise ValueError("the curve of its response does not rise from 0 to 1")
    return Response(levels, light, name)


def _patterns(place: Path, attributes: Mapping[str, Any], count: int) -> PatternSet:
    entry = attributes.get("patterns")
    description = entry.get("description") if isinstance(entry, dict) else None
    if not isinstance(description, dict):
        raise ValueError("its patterns are not described")
    shape = attributes["projector_shape"]
    if not (isinstance(shape, list) and len(shape) == 2):
        raise ValueError("its projector has no shape")
    rows, cols = (int(n) for n in shape)
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
    # The fast operator that made them is used if it still makes the same bits.
    made = remake_patterns(description)
    if made is None or made.count != count or made.shape != (rows, cols):
        return stored
    remade = made.as_bits()
    return made if remade is not None and np.array_equal(remade, bits) else stored


def _array(place: Path, name: str, shape: tuple[int, ...], kinds: str) -> NDArray[Any] | None:
    """One of the small arrays, read whole; None if there is none."""
    if not (place / name).exists():
        return None
    array = StoredArray.open(place / name)
    if array.shape != shape or array.dtype.kind not in kinds:
        raise ValueError(f"its {name} is {array.dtype} of shape {array.shape}")
    check_memory(place, array.bytes)
    values = array.read()
    if array.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"its {name} is not finite")
    return values


def _within(outer: slice, inner: slice) -> slice:
    return slice(outer.start + inner.start, outer.start + inner.stop)
