"""Stacks of frames, on disk or in memory, and the reader that decodes them into samples."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.correction import Correction
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.exposures import frame_weights
from lightmatrix.capture.samples import Samples, bin_samples
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.regions import Region
from lightmatrix.reprs import ShortRepr
from lightmatrix.resources.memory import scratch_array
from lightmatrix.resources.threads import computed_once, work_ahead

# Raw levels that are read together, of all frames at some camera pixels. Chosen by hand: they take
# 16 to 64 MB, depending on their type.
BLOCK_LEVELS = 1 << 24


class Frames(Protocol):
    """A stack of frames of one shape and type, read one at a time."""

    @property
    def count(self) -> int:
        """Number of frames K."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels) of a frame."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """uint8, uint16 or float32."""

    def read(self, index: int) -> NDArray[Any]:
        """One frame as it is stored."""

    def name(self, index: int) -> str:
        """The name of a frame in messages."""

    def select(self, index: Sequence[int]) -> "Frames":
        """The frames of the given indices."""


@runtime_checkable
class PixelFrames(Frames, Protocol):
    """Frames stored by camera pixel: some pixels in all frames are read fast, a frame slowly."""

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        """Raw levels of the camera samples start..stop in all frames, (stop - start, K)."""

    def part(self, rows: slice, cols: slice) -> "PixelFrames":
        """A rectangle of the camera's pixels, with start and stop and without step."""

    def select(self, index: Sequence[int]) -> "PixelFrames":
        """The frames of the given indices."""


def in_order(frames: Frames, start: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
    """The frames start..stop one after the other; files are read ahead."""
    stop = frames.count if stop is None else stop
    threads = 1 if isinstance(frames, ArrayStack | PixelFrames) else None
    return work_ahead(frames.read, range(start, stop), threads)


def level_blocks(frames: Frames) -> Iterator[NDArray[Any]]:
    """All raw levels once, in blocks of bounded size, in the fastest order."""
    if not isinstance(frames, PixelFrames):
        yield from in_order(frames)
        return
    pixels, step = math.prod(frames.shape), max(1, BLOCK_LEVELS // frames.count)
    for start in range(0, pixels, step):
        yield frames.levels(start, min(start + step, pixels))


def levels_at(frames: Frames, places: NDArray[np.int64]) -> NDArray[Any]:
    """Raw levels of the camera samples `places`, (S,), in all frames, (S, K), each read once."""
    levels = np.empty((len(places), frames.count), frames.dtype)
    if not isinstance(frames, PixelFrames):
        for k, frame in enumerate(in_order(frames)):
            levels[:, k] = frame.reshape(-1)[places]
        return levels
    start = 0
    for block in level_blocks(frames):
        inside = np.flatnonzero((places >= start) & (places < start + len(block)))
        levels[inside] = block[places[inside] - start]
        start += len(block)
    return levels


@dataclass(frozen=True, eq=False, repr=False)
class ArrayStack(ShortRepr):
    """Frames in memory, (K, rows, cols[, channels]) uint8, uint16 or float32."""

    array: NDArray[Any]

    @property
    def count(self) -> int:
        return len(self.array)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.array.shape[1:]

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        frame: NDArray[Any] = self.array[index]
        return frame

    def name(self, index: int) -> str:
        return f"frame {index}"

    def select(self, index: Sequence[int]) -> "ArrayStack":
        return ArrayStack(self.array[list(index)])


@dataclass(frozen=True)
class CutFrames:
    """A rectangle of frames, cut out of each frame as it is read."""

    frames: Frames
    region: Region

    @property
    def count(self) -> int:
        return self.frames.count

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.region.shape, *self.frames.shape[2:])

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.frames.dtype

    def read(self, index: int) -> NDArray[Any]:
        """The rectangle of one frame, as a copy, so that the whole frame is freed."""
        return self.frames.read(index)[self.region.slices].copy()

    def name(self, index: int) -> str:
        return self.frames.name(index)

    def select(self, index: Sequence[int]) -> "CutFrames":
        return replace(self, frames=self.frames.select(index))


@dataclass(frozen=True)
class CutPixels(CutFrames):
    """A rectangle of frames that are stored by camera pixel, read as fast as these."""

    frames: PixelFrames

    @cached_property
    def _part(self) -> PixelFrames:
        return self.frames.part(*self.region.slices)

    def read(self, index: int) -> NDArray[Any]:
        """The rectangle of one frame."""
        return self._part.read(index)

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        return self._part.levels(start, stop)

    def part(self, rows: slice, cols: slice) -> PixelFrames:
        return self._part.part(rows, cols)

    def select(self, index: Sequence[int]) -> "CutPixels":
        return replace(self, frames=self.frames.select(index))


def cut(frames: Frames, corner: tuple[int, int], shape: tuple[int, int]) -> CutFrames:
    """A rectangle of frames, which may themselves be cut, from a corner of (row, col)."""
    rows, cols = frames.shape[:2]
    region = Region(corner, shape, (rows, cols))
    whole = frames
    if isinstance(frames, CutFrames):
        whole, region = frames.frames, region.within(frames.region)
    if isinstance(whole, PixelFrames):
        return CutPixels(whole, region)
    return CutFrames(whole, region)


# Samples of one frame that are binned at a time. Chosen by hand: a whole frame of 24 megapixels
# would take gigabytes for a moment.
_STRIP = 1 << 20


class Reader:
    """Linear samples of K frames, averaged over blocks; `Capture` extends it by the patterns."""

    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None
    bin_camera: tuple[int, int]
    correction: Correction | None
    known: Samples | None

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Camera rows, columns and, for a colour camera, channels, binned."""
        rows, cols, *channels = self.frames.shape
        return (-(-rows // self.bin_camera[0]), -(-cols // self.bin_camera[1]), *channels)

    @property
    def rows(self) -> int:
        """Number of camera samples M, binned."""
        return int(np.prod(self.camera_shape))

    @property
    def exposures(self) -> NDArray[np.float64]:
        """Exposure of each frame, (K,)."""
        return np.broadcast_to(np.asarray(self.decoder.exposure, np.float64), (self.frames.count,))

    def tiles(self, rows: int = 4096) -> Iterator[tuple[int, Samples]]:
        """Iterate over (first row, samples) of the whole camera."""
        for start in range(0, self.rows, rows):
            yield start, self.samples(start, start + rows)

    def samples(self, start: int = 0, stop: int | None = None) -> Samples:
        """Linear samples of the camera rows start..stop, decoded from the raw frames.

        They are for exposure 1, in units of the clip level, as `Problem` takes them. Masked ones
        are 0 and have weight 0.
        """
        stop = self.rows if stop is None else min(stop, self.rows)
        if self.known is not None:
            samples = self.known.rows(slice(start, stop))
        else:
            if self.bin_camera == (1, 1):
                samples = self.decoder.decode(self.levels(start, stop), first_row=start)
            else:
                samples = self._binned.rows(slice(start, stop))
            valid, weights = self.valid[start:stop, None], frame_weights(self.exposures)
            values, clipped = samples.values, samples.clipped
            if not valid.all():
                values, clipped = values * valid, clipped & valid
                every = np.ones(self.frames.count, np.float32) if weights is None else weights
                weights = valid * every
            samples = Samples(values, clipped, samples.clip_level, weights)
        if self.correction is None:
            return samples
        return self.correction.applied(samples, start, self.camera_shape)

    @computed_once
    def valid(self) -> NDArray[np.bool_]:
        """Camera samples that are not masked and do not clip without light, (M,)."""
        if self.bin_camera == (1, 1):
            return self._valid_pixels
        valid = self._valid_pixels.reshape(*self.frames.shape[:2], -1)
        for axis in (0, 1):
            starts = np.arange(0, valid.shape[axis], self.bin_camera[axis])
            valid = np.logical_or.reduceat(valid, starts, axis=axis)
        return valid.ravel()

    @computed_once
    def _valid_pixels(self) -> NDArray[np.bool_]:
        hot = self.decoder.hot
        valid = np.ones(int(np.prod(self.frames.shape)), bool) if hot is None else ~hot
        return valid if self.mask is None else valid & self.mask.ravel()

    def levels(self, start: int, stop: int) -> NDArray[Any]:
        """Raw levels of the unbinned camera samples start..stop in all frames, (n, K)."""
        if isinstance(self.frames, PixelFrames):
            return self.frames.levels(start, stop)
        return self.raw[start:stop]

    @computed_once
    def raw(self) -> NDArray[Any]:
        """Raw levels (M, K): the frames of a camera sample lie side by side, as tiles need them."""
        pixels = int(np.prod(self.frames.shape))
        raw = scratch_array((pixels, self.frames.count), self.frames.dtype)
        # Up to 64 frames, or 256 MiB of them, are transposed together: one by one, each would touch
        # every page of the array.
        group = max(1, min(64, (256 << 20) // max(1, pixels * raw.itemsize)))
        for start in range(0, self.frames.count, group):
            stop = min(start + group, self.frames.count)
            images = [frame.reshape(-1) for frame in in_order(self.frames, start, stop)]
            raw[:, start:stop] = np.stack(images, axis=1)
        return raw

    @computed_once
    def _binned(self) -> Samples:
        """Binned samples (M, K), which take less memory than the raw levels from 2 x 2 on."""
        values = scratch_array((self.rows, self.frames.count), np.dtype(np.float32))
        clipped = scratch_array((self.rows, self.frames.count), np.dtype(np.bool_))
        # Clip levels differ from frame to frame, from sample to sample, or both.
        frame_levels = np.empty(self.frames.count, np.float32)
        settings = (self.decoder.clip, self.decoder.black_level)
        alike = np.ptp(self.exposures) == 0 and not any(map(np.ndim, settings))
        sample_levels = None
        for where, first, k, raw in self._columns():
            decoded = self.decoder.decode(raw, first_row=first, first_frame=k)
            shape = (len(raw) // math.prod(self.frames.shape[1:]), *self.frames.shape[1:])
            valid = self._valid_pixels[first : first + len(raw)]
            binned = bin_samples(decoded, valid, shape, self.bin_camera)
            values[where, k], clipped[where, k] = binned.values[:, 0], binned.clipped[:, 0]
            if binned.clip_level.ndim == 1:
                frame_levels[k] = binned.clip_level[0]
                continue
            if sample_levels is None:
                columns = 1 if alike else self.frames.count
                sample_levels = scratch_array((self.rows, columns), np.dtype(np.float32))
            if k == 0 or not alike:
                sample_levels[where, k] = binned.clip_level[:, 0]
        if sample_levels is None:
            return Samples(values, clipped, frame_levels)
        return Samples(values, clipped, np.broadcast_to(sample_levels, values.shape))

    def _columns(self) -> Iterator[tuple[slice, int, int, NDArray[Any]]]:
        """Strips in the faster order: binned rows, first sample, frame, and raw levels (n, 1)."""
        frames, down = self.frames, self.bin_camera[0]
        wide, narrow = (math.prod(shape[1:]) for shape in (frames.shape, self.camera_shape))
        if not isinstance(frames, PixelFrames):
            step = down * max(1, _STRIP // (down * wide))
            for k, frame in enumerate(in_order(frames)):
                for top in range(0, len(frame), step):
                    end = min(top + step, len(frame))
                    where = slice(top // down * narrow, -(-end // down) * narrow)
                    yield where, top * wide, k, frame[top:end].reshape(-1, 1)
            return
        step = down * max(1, BLOCK_LEVELS // (frames.count * wide * down))
        for top in range(0, frames.shape[0], step):
            end = min(top + step, frames.shape[0])
            levels = frames.levels(top * wide, end * wide)
            where = slice(top // down * narrow, -(-end // down) * narrow)
            for k in range(frames.count):
                yield where, top * wide, k, np.ascontiguousarray(levels[:, k : k + 1])


@dataclass(frozen=True, eq=False)
class CaptureParts:
    """The parts of a capture as read from disk; patterns and frames may still differ in number."""

    patterns: PatternSet
    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    # Whether the patterns are grey values whose light is to be found in the frames.
    projector_unknown: bool = False
    # Rows and columns of each of several projectors.
    projectors: tuple[tuple[int, int], ...] = ()
