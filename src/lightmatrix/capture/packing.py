"""Packing: writes the frames of a capture into one array, chunked by tiles of camera pixels."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.folder import write_description
from lightmatrix.capture.frames import Frames, PixelFrames, in_order
from lightmatrix.capture.packed import FORMAT, FRAMES, PACKED, VERSION
from lightmatrix.capture.settings import DEPTH, GEOMETRY, TRUTH
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CAPTURE
from lightmatrix.files.writing import atomic_folder, check_output
from lightmatrix.files.zarr_arrays import create_array
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.ranges import as_path
from lightmatrix.resources.disk import check_disk_space, scratch_array

Progress = Callable[[int, int], None]
# Called with a number of camera rows, iterates over strips of that height: the levels of all
# frames, (K, rows, cols[, channels]). The last strip may have fewer rows.
Strips = Callable[[int], Iterator[NDArray[Any]]]

# Bytes of one chunk. Chosen by hand: small enough that a tile of camera pixels reads little more
# than its own samples, and large enough to compress well.
_CHUNK_BYTES = 1 << 20


def pack(
    capture: Capture | str | Path,
    output: str | Path,
    *,
    memory: int = 1 << 30,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a capture folder with all frames in one array, from which tiles are read fast.

    `Capture.open` reads the same capture back. Every frame is read once, in bounded memory. An
    interrupted run leaves nothing behind.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, not binned; or a capture folder, whose truth.npz is copied.
    output : str or Path
        Capture folder to write.
    memory : int
        Bytes to work in. Captures larger than half of it are transposed through a temporary file
        beside the output, as large as their levels.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) frames.

    Raises
    ------
    InputError
        On a capture that is binned, or frames that cannot be read.
    OutputError
        If the output exists or cannot be written, or the disk is too small, which is checked before
        a frame is read.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    >>> lm.pack(capture, "packed")
    >>> lm.Capture.open("packed").digest == capture.digest
    True
    """
    check_output(output, CAPTURE, overwrite=overwrite)
    opened = open_capture(capture)
    source = None if isinstance(capture, Capture) else as_path(capture)

    def copy_truth(part: Path) -> None:
        for name in (TRUTH, GEOMETRY, DEPTH):
            if source is not None and (source / name).is_file():
                shutil.copyfile(source / name, part / name)

    pack_capture(
        opened,
        output,
        write_extras=copy_truth,
        memory=memory,
        overwrite=overwrite,
        progress=progress,
    )


def pack_capture(
    capture: Capture,
    output: str | Path,
    *,
    write_extras: Callable[[Path], None],
    memory: int = 1 << 30,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Pack a capture as `pack` does; `write_extras` writes further files into the folder."""
    if capture.bin_projector != (1, 1) or capture.bin_camera != (1, 1):
        raise InputError("a binned capture cannot be packed", hint="pack it first, then bin it")
    frames, output = capture.frames, Path(output)
    size = frames.count * math.prod(frames.shape) * frames.dtype.itemsize
    # The place of cropped photographs is part of their description.
    crop = capture.description.get("crop")
    provenance = capture.provenance if crop is None else {**capture.provenance, "crop": crop}
    write_packed(
        output,
        capture.patterns,
        _strips(frames, output.absolute().parent, memory, progress or (lambda done, total: None)),
        decoder=capture.decoder,
        shape=frames.shape,
        dtype=frames.dtype,
        names=[frames.name(k) for k in range(frames.count)],
        write_extras=write_extras,
        # Frames that do not fit into memory lie beside the output until it is whole.
        copies=1 if isinstance(frames, PixelFrames) or size <= memory // 2 else 2,
        overwrite=overwrite,
        mask=capture.mask,
        provenance=provenance,
        projector_unknown=capture.projector_unknown,
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
    write_extras: Callable[[Path], None] | None = None,
    copies: int = 1,
    overwrite: bool = False,
    **described: Any,
) -> None:
    """Write a packed capture of K frames strip by strip, whole or not at all.

    `shape` and `dtype` are those of a frame. `write_extras` writes further files into the folder.
    The disk must have room for as many `copies` of the levels. `described` is what else
    `write_description` takes.
    """
    count, dtype = len(names), np.dtype(dtype)
    # A chunk holds all frames of some whole camera rows, or of a part of one.
    pixels = max(1, _CHUNK_BYTES // (count * math.prod(shape[2:]) * dtype.itemsize))
    rows, cols = min(shape[0], max(1, pixels // shape[1])), min(shape[1], pixels)
    with atomic_folder(output, CAPTURE, overwrite=overwrite) as part:
        # Noise hardly compresses, so the output may be as large as the levels.
        levels = count * math.prod(shape) * dtype.itemsize
        check_disk_space(part, copies * levels, output)
        group = zarr.open_group(part / PACKED, mode="w", zarr_format=3)
        chunks = (count, rows, cols, *shape[2:])
        frames = create_array(group, FRAMES, (count, *shape), dtype, chunks)
        top = 0
        for strip in strips(rows):
            frames[:, top : top + strip.shape[1]] = strip
            top += strip.shape[1]
        group.attrs.update({"format": FORMAT, "version": VERSION, "names": list(names)})
        write_description(part, patterns, shape, decoder, **described)
        if write_extras is not None:
            write_extras(part)


def _strips(frames: Frames, folder: Path, memory: int, progress: Progress) -> Strips:
    """Strips of frames: read as stored, or transposed in memory or through a file in `folder`."""
    count, height, line = frames.count, frames.shape[0], frames.shape[1:]
    wide = math.prod(line)

    def strips(rows: int) -> Iterator[NDArray[Any]]:
        if isinstance(frames, PixelFrames):
            for top in range(0, height, rows):
                end = min(top + rows, height)
                levels = frames.levels(top * wide, end * wide)
                yield levels.T.reshape(count, end - top, *line)
                progress(count * end // height, count)
            return
        stack = scratch_array((count, *frames.shape), frames.dtype, memory // 2, folder)
        for k, frame in enumerate(in_order(frames)):
            stack[k] = frame
            progress(k + 1, count)
        # The frames lie one after the other, so many strips of each are copied at a time.
        many = rows * max(1, memory // 4 // (rows * wide * count * frames.dtype.itemsize))
        for top in range(0, height, many):
            block = np.ascontiguousarray(stack[:, top : top + many])
            for inner in range(0, block.shape[1], rows):
                yield block[:, inner : inner + rows]

    return strips
