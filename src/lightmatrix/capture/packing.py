"""Packing: the frames of a capture into one array, chunked by tiles of camera pixels."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import zarr
from numpy.typing import NDArray

from lightmatrix.camera.decoder import Decoder
from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.description import TRUTH
from lightmatrix.capture.frames import Frames, PixelFrames, in_order
from lightmatrix.capture.packed import (
    BITS,
    BLACK,
    CURVE,
    FORMAT,
    FRAMES,
    LEVELS,
    MASK,
    VERSION,
)
from lightmatrix.errors import InputError
from lightmatrix.files.zarr_arrays import create_array, write_array
from lightmatrix.outputs.kinds import PACKED_CAPTURE
from lightmatrix.outputs.writing import atomic_folder, check_output
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.reprs import jsonable
from lightmatrix.resources.disk import check_disk

Progress = Callable[[int, int], None]
# Gives all frames' levels of some camera rows at a time, (K, rows, cols[, channels]), of as many
# rows as it is asked for, the last fewer.
Strips = Callable[[int], Iterator[NDArray[Any]]]

# Of one chunk: small enough that a tile of camera pixels reads little more than its own samples.
_CHUNK_BYTES = 1 << 20
# Frames up to half of this are turned over in memory, more of them through a file.
MEMORY = 1 << 30


def pack(
    capture: Capture | str | Path,
    output: str | Path,
    *,
    memory: int = MEMORY,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Put the frames of a capture into one array, so that a tile of camera pixels is read alone.

    `Capture.open` gives back the same capture: frames, patterns, levels, exposures, black frame,
    response, mask. Every frame is read once, in bounded memory. An interrupted packing leaves
    nothing and starts anew.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, not binned; or a capture folder, whose truth.npz goes with it.
    output : str or Path
        Ends in .zarr; whole or not at all.
    memory : int
        Bytes to work in. Captures of more than half of it are turned over through a temporary
        file beside the output, as large as their levels.
    overwrite : bool
        Whether an existing packed capture may be replaced.
    progress : callable, optional
        Called with (done, total) frames.

    Raises
    ------
    InputError
        On a capture that is binned, or frames that cannot be read.
    OutputError
        If the output exists, the disk has not enough room for it (said before anything is read),
        or it cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> lm.pack(capture, "metal.zarr")
    >>> lm.Capture.open("metal.zarr").digest == capture.digest
    True
    """
    check_output(output, PACKED_CAPTURE, overwrite=overwrite)
    opened = open_capture(capture)
    truth = None if isinstance(capture, Capture) else Path(capture) / TRUTH

    def beside(part: Path) -> None:
        if truth is not None and truth.is_file():
            shutil.copyfile(truth, part / TRUTH)

    pack_capture(
        opened, output, beside=beside, memory=memory, overwrite=overwrite, progress=progress
    )


def pack_capture(
    capture: Capture,
    output: str | Path,
    *,
    beside: Callable[[Path], None],
    memory: int = MEMORY,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Pack a capture as `pack` does; `beside` writes what else belongs into the folder."""
    if capture.bin_projector != (1, 1) or capture.bin_camera != (1, 1):
        raise InputError("a binned capture cannot be packed", hint="pack it first, then bin it")
    frames = capture.frames
    turned = isinstance(frames, PixelFrames) or _bytes(frames) <= memory // 2
    folder = Path(output).absolute().parent
    # Where cropped photographs lay is part of what describes them.
    crop = capture.description.get("crop")
    told = capture.provenance if crop is None else {**capture.provenance, "crop": crop}
    write_packed(
        output,
        capture.patterns,
        _strips(frames, None if turned else folder, memory, progress),
        decoder=capture.decoder,
        shape=frames.shape,
        dtype=frames.dtype,
        names=[frames.name(k) for k in range(frames.count)],
        mask=capture.mask,
        provenance=told,
        beside=beside,
        temporary=0 if turned else _bytes(frames),
        overwrite=overwrite,
    )


def write_packed(
    output: str | Path,
    patterns: PatternSet,
    strips: Strips,
    *,
    decoder: Decoder,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    names: Sequence[str],
    mask: NDArray[np.bool_] | None = None,
    provenance: Mapping[str, Any] | None = None,
    beside: Callable[[Path], None] | None = None,
    temporary: int = 0,
    overwrite: bool = False,
) -> None:
    """Write a packed capture strip by strip, whole or not at all.

    Parameters
    ----------
    output : str or Path
        Ends in .zarr.
    patterns : PatternSet
        K patterns.
    strips : callable
        Given how many camera rows a strip has, iterates over (K, rows, cols[, channels]) levels.
    decoder : Decoder
        From raw levels to linear samples.
    shape, dtype : tuple of int, numpy.dtype
        Of a frame.
    names : sequence of str
        What the K frames are called.
    mask : shape of a frame, bool, optional
        Which camera samples count.
    provenance : mapping, optional
        What made the capture, JSON-ready.
    beside : callable, optional
        Given the folder before it is whole, writes what else belongs into it.
    temporary : int
        Bytes that are needed beside the output meanwhile.
    overwrite : bool
        Whether an existing packed capture may be replaced.

    Raises
    ------
    OutputError
        If it exists, the disk has not enough room, or it cannot be written.
    """
    count, dtype = len(names), np.dtype(dtype)
    rows, cols = _tile(count, shape, dtype)
    levels = count * math.prod(shape) * dtype.itemsize
    with atomic_folder(output, PACKED_CAPTURE, overwrite=overwrite) as part:
        # Noise hardly compresses, so that the levels themselves are the bound to count on.
        check_disk(part, levels + temporary, output)
        group = zarr.open_group(part, mode="w", zarr_format=3)
        frames = create_array(
            group, FRAMES, (count, *shape), dtype, (count, rows, cols, *shape[2:])
        )
        top = 0
        for strip in strips(rows):
            frames[:, top : top + strip.shape[1]] = strip
            top += strip.shape[1]
        for name, values in _small_arrays(patterns, decoder, shape, mask).items():
            write_array(group, name, values)
        content = {
            "format": FORMAT,
            "version": VERSION,
            "projector_shape": list(patterns.shape),
            "camera_shape": list(shape),
            "names": list(names),
            "patterns": {"description": patterns.description, "digest": patterns.digest},
            "exposure": decoder.exposure,
            "clip": decoder.clip,
            "clip_assumed": decoder.clip_assumed,
            "black_level": decoder.black_level,
            "full_scale": decoder.full_scale,
            "response": decoder.response.name,
            "provenance": dict(provenance or {}),
        }
        if decoder.black_exposure is not None:
            content["black_exposure"] = decoder.black_exposure
        # Last, so that a group without attributes is never taken for a whole one.
        group.attrs.update(json.loads(json.dumps(content, default=jsonable)))
        if beside is not None:
            beside(part)


def _tile(count: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int]:
    """Camera rows and columns of a chunk: whole rows in the order of T's, or a part of one."""
    pixel = count * math.prod(shape[2:]) * dtype.itemsize
    fitting = max(1, _CHUNK_BYTES // pixel)
    return min(shape[0], max(1, fitting // shape[1])), min(shape[1], fitting)


def _small_arrays(
    patterns: PatternSet,
    decoder: Decoder,
    shape: tuple[int, ...],
    mask: NDArray[np.bool_] | None,
) -> dict[str, NDArray[Any]]:
    bits = patterns.as_bits()
    shown = {LEVELS: patterns.images()} if bits is None else {BITS: bits}
    found: dict[str, NDArray[Any]] = dict(shown)
    if decoder.black_frame is not None:
        found[BLACK] = np.asarray(decoder.black_frame).reshape(shape)
    if mask is not None:
        found[MASK] = mask
    response = decoder.response
    if response.levels is not None and response.light is not None:
        found[CURVE] = np.stack([response.levels, response.light])
    return found


def _bytes(frames: Frames) -> int:
    return frames.count * math.prod(frames.shape) * frames.dtype.itemsize


def _strips(frames: Frames, spool: Path | None, memory: int, progress: Progress | None) -> Strips:
    """Strips of frames: as they lie, turned over in memory, or through a file in a folder."""

    def by_pixel(rows: int) -> Iterator[NDArray[Any]]:
        assert isinstance(frames, PixelFrames)
        wide = math.prod(frames.shape[1:])
        for top in range(0, frames.shape[0], rows):
            end = min(top + rows, frames.shape[0])
            levels = frames.levels(top * wide, end * wide)
            yield levels.T.reshape(frames.count, end - top, *frames.shape[1:])
            _tell(progress, frames.count * end // frames.shape[0], frames.count)

    def in_memory(rows: int) -> Iterator[NDArray[Any]]:
        stack = np.empty((frames.count, *frames.shape), frames.dtype)
        for k, frame in enumerate(in_order(frames)):
            stack[k] = frame
            _tell(progress, k + 1, frames.count)
        for top in range(0, frames.shape[0], rows):
            yield stack[:, top : top + rows]

    def through_file(rows: int) -> Iterator[NDArray[Any]]:
        with tempfile.TemporaryFile(dir=spool) as file:
            for k, frame in enumerate(in_order(frames)):
                file.write(np.ascontiguousarray(frame).data)
                _tell(progress, k + 1, frames.count)
            yield from _from_file(file, frames, rows, memory)

    if isinstance(frames, PixelFrames):
        return by_pixel
    return in_memory if spool is None else through_file


def _from_file(file: IO[bytes], frames: Frames, rows: int, memory: int) -> Iterator[NDArray[Any]]:
    """Strips of frames that lie one after the other in a file; many strips at a time."""
    line = math.prod(frames.shape[1:]) * frames.dtype.itemsize
    group = rows * max(1, memory // 4 // (rows * line * frames.count))
    for top in range(0, frames.shape[0], group):
        height = min(group, frames.shape[0] - top)
        block = np.empty((frames.count, height, *frames.shape[1:]), frames.dtype)
        for k in range(frames.count):
            file.seek((k * frames.shape[0] + top) * line)
            file.readinto(block[k].data)  # type: ignore[attr-defined]
        for inner in range(0, height, rows):
            yield block[:, inner : inner + rows]


def _tell(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)
