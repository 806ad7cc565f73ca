"""Packing: writes the frames of a capture into one array, chunked by tiles of camera pixels."""

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import lazy_loader
import numpy as np

from lightmatrix.capture.capture import Capture, open_capture
from lightmatrix.capture.folder import write_description
from lightmatrix.capture.packed import FORMAT, FRAMES, PACKED, VERSION
from lightmatrix.capture.settings import DEPTH, GEOMETRY, TRUTH
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CAPTURE
from lightmatrix.files.writing import atomic_folder, check_output
from lightmatrix.files.zarr_arrays import create_array
from lightmatrix.paths import as_path
from lightmatrix.progress import Progress
from lightmatrix.resources.memory import check_disk_space

zarr = lazy_loader.load("zarr")

# Bytes of one chunk. Chosen by hand: small enough that a tile of camera pixels reads little more
# than its own samples, and large enough to compress well.
_CHUNK_BYTES = 1 << 20


def pack(
    capture: Capture | str | Path,
    output: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a capture folder with all frames in one array, from which tiles are read fast.

    `Capture.open` reads the same capture back. Every frame is read once, and levels of more than
    2 GiB are transposed through a temporary file. An interrupted run leaves nothing behind.

    Parameters
    ----------
    capture : Capture, str or Path
        A capture, not binned; or a capture folder, whose truth.npz is copied.
    output : str or Path
        Capture folder to write.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) camera rows, after all frames were read.

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
    source = None if isinstance(capture, Capture) else as_path(capture)

    def copy_truth(part: Path) -> None:
        for name in (TRUTH, GEOMETRY, DEPTH):
            if source is not None and (source / name).is_file():
                shutil.copyfile(source / name, part / name)

    opened = open_capture(capture)
    pack_capture(opened, output, copy_truth, overwrite=overwrite, progress=progress)


def pack_capture(
    capture: Capture,
    output: str | Path,
    write_extras: Callable[[Path], None],
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> None:
    """Pack a capture as `pack` does; `write_extras` writes further files into the folder."""
    if capture.bin_projector != (1, 1) or capture.bin_camera != (1, 1):
        raise InputError("a binned capture cannot be packed", hint="pack it first, then bin it")
    frames, count = capture.frames, capture.count
    (height, width, *channels), dtype = frames.shape, np.dtype(frames.dtype)
    # A chunk holds all frames of some whole camera rows, or of a part of one.
    pixels = max(1, _CHUNK_BYTES // (count * math.prod(channels) * dtype.itemsize))
    rows, cols = min(height, max(1, pixels // width)), min(width, pixels)
    # The place of cropped photographs is part of their description.
    crop = capture.description.get("crop")
    provenance = capture.provenance if crop is None else {**capture.provenance, "crop": crop}
    with atomic_folder(output, CAPTURE, overwrite=overwrite) as part:
        # Noise hardly compresses, so the output may be as large as the levels.
        check_disk_space(part, count * math.prod(frames.shape) * dtype.itemsize, output)
        group = zarr.open_group(part / PACKED, mode="w", zarr_format=3)
        chunks = (count, rows, cols, *channels)
        packed = create_array(group, FRAMES, (count, *frames.shape), dtype, chunks)
        line = math.prod(frames.shape[1:])
        for top in range(0, height, rows):
            end = min(top + rows, height)
            levels = capture.levels(top * line, end * line)
            packed[:, top:end] = levels.T.reshape(count, end - top, *frames.shape[1:])
            if progress is not None:
                progress(end, height)
        names = [frames.name(k) for k in range(count)]
        group.attrs.update({"format": FORMAT, "version": VERSION, "names": names})
        write_description(
            part, capture.patterns, frames.shape, capture.decoder, mask=capture.mask,
            provenance=provenance, projectors=capture.projectors,
            projector_unknown=capture.projector_unknown,
        )  # fmt: skip
        write_extras(part)
