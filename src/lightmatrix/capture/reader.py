"""The reader: decodes frames into linear samples, tile by tile, and bins them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.noise import frame_weights
from lightmatrix.camera.samples import Samples, bin_samples
from lightmatrix.capture.frames import BLOCK_LEVELS, Frames, PixelFrames, in_order
from lightmatrix.resources.disk import scratch_array
from lightmatrix.resources.threads import computed_once

# Samples of one frame that are binned at a time. Chosen by hand: a whole frame of 24 megapixels
# would take gigabytes for a moment.
_STRIP = 1 << 20
# Rows of samples in a tile, where the caller does not say how many.
_TILE_ROWS = 4096
# The most frames, and the most bytes of them, that are transposed together. One by one, each frame
# would touch every page of the array.
_GROUP_FRAMES, _GROUP_BYTES = 64, 256 << 20


@dataclass(frozen=True, eq=False)
class Reader:
    """Linear samples of K frames within a mask, averaged over blocks of (rows, cols)."""

    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None
    block: tuple[int, int]

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Camera rows, columns and, for a colour camera, channels, binned."""
        rows, cols, *channels = self.frames.shape
        return (-(-rows // self.block[0]), -(-cols // self.block[1]), *channels)

    @property
    def rows(self) -> int:
        """Number of camera samples M, binned."""
        return int(np.prod(self.camera_shape))

    @property
    def exposures(self) -> NDArray[np.float64]:
        """Exposure of each frame, (K,)."""
        return np.broadcast_to(np.asarray(self.decoder.exposure, np.float64), (self.frames.count,))

    def tiles(self, rows: int = _TILE_ROWS) -> Iterator[tuple[int, Samples]]:
        """Iterate over (first row, samples) of the whole camera."""
        for start in range(0, self.rows, rows):
            yield start, self.samples(start, start + rows)

    def samples(self, start: int, stop: int) -> Samples:
        """Samples of the camera rows start..stop; masked ones are 0 and have weight 0."""
        stop = min(stop, self.rows)
        if self.block == (1, 1):
            decoded = self.decoder.decode(self.levels(start, stop), first_row=start)
        else:
            decoded = self._binned.rows(slice(start, stop))
        valid = self.valid[start:stop]
        weights = frame_weights(self.exposures)
        if valid.all():
            return Samples(decoded.values, decoded.clipped, decoded.clip_level, weights)
        if weights is None:
            weights = np.ones(self.frames.count, np.float32)
        return Samples(
            decoded.values * valid[:, None],
            decoded.clipped & valid[:, None],
            decoded.clip_level,
            valid[:, None] * weights,
        )

    @computed_once
    def valid(self) -> NDArray[np.bool_]:
        """Which camera samples count: not masked, and not clipped without light; (M,)."""
        if self.block == (1, 1):
            return self._valid_pixels
        parts = []
        for rows, pixels in self._strips():
            nothing = np.zeros((pixels.stop - pixels.start, 1), np.float32)
            empty = Samples(nothing, nothing > 0, np.ones(1, np.float32))
            shape = (rows.stop - rows.start, *self.frames.shape[1:])
            parts.append(bin_samples(empty, self._valid_pixels[pixels], shape, self.block)[1])
        return np.concatenate(parts)

    def _strips(self) -> Iterator[tuple[slice, slice]]:
        """Rows of a frame that are binned at a time, and the slice of their samples."""
        height, *others = self.frames.shape
        width = int(np.prod(others))
        step = self.block[0] * max(1, _STRIP // (self.block[0] * width))
        for start in range(0, height, step):
            stop = min(start + step, height)
            yield slice(start, stop), slice(start * width, stop * width)

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

    def level_blocks(self) -> Iterator[NDArray[Any]]:
        """All raw levels once, some camera samples at a time."""
        pixels = int(np.prod(self.frames.shape))
        step = max(1, BLOCK_LEVELS // self.frames.count)
        for start in range(0, pixels, step):
            yield self.levels(start, min(start + step, pixels))

    @computed_once
    def raw(self) -> NDArray[Any]:
        """Raw levels (M, K): the frames of a camera sample lie side by side, as tiles need them."""
        pixels = int(np.prod(self.frames.shape))
        raw = scratch_array((pixels, self.frames.count), self.frames.dtype)
        group = max(1, min(_GROUP_FRAMES, _GROUP_BYTES // max(1, pixels * raw.itemsize)))
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
            binned, _ = bin_samples(decoded, valid, shape, self.block)
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
        """Strips of frames in the faster order: of one frame after the other, or of all frames.

        Each has its rows of binned samples, first sample, frame number and raw levels (n, 1).
        """
        frames, down = self.frames, self.block[0]
        wide, narrow = (math.prod(shape[1:]) for shape in (frames.shape, self.camera_shape))
        if not isinstance(frames, PixelFrames):
            for k, frame in enumerate(in_order(frames)):
                for rows, pixels in self._strips():
                    where = slice(rows.start // down * narrow, -(-rows.stop // down) * narrow)
                    yield where, pixels.start, k, frame[rows].reshape(-1, 1)
            return
        step = down * max(1, BLOCK_LEVELS // (frames.count * wide * down))
        for top in range(0, frames.shape[0], step):
            end = min(top + step, frames.shape[0])
            levels = frames.levels(top * wide, end * wide)
            where = slice(top // down * narrow, -(-end // down) * narrow)
            for k in range(frames.count):
                yield where, top * wide, k, np.ascontiguousarray(levels[:, k : k + 1])
