"""`lm.convert`: captures of other programs as capture folders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.layouts import find_layout
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.images import read_image
from lightmatrix.patterns.pattern_set import ImagePatterns


def convert(
    folder: str | Path,
    output: str | Path,
    *,
    channel: str = "green",
    response: str = "linear",
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> str:
    """Write a capture folder from patterns and photographs in the layout of another program.

    Parameters
    ----------
    folder : str or Path
        A setup of CompenNet's data (it holds cam/raw/train; the pictures are in train/, up to four
        folders above); a folder of SLStudio's frames (frameSeq_*) and patterns (pat_*); or a
        folder with patterns/, a numbered folder of photographs for each pattern, and their
        exposures in exposures.json or exposures.csv.
    output : str or Path
        The capture folder to make.
    channel : {"red", "green", "blue"}
        The channel of colour patterns and of colour photographs that is kept.
    response : str
        The camera's response, see `Response.parse`; "auto" lets `estimate` find it.
    overwrite : bool
        Whether an existing capture may be replaced.
    progress : callable, optional
        Called with (done, total) frames.

    Returns
    -------
    str
        The layout: "CompenNet", "SLStudio" or "brackets".

    Raises
    ------
    InputError
        If the folder has none of these layouts, files are missing, or images differ in size.
    OutputError
        If the output exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> for k in range(3):
    ...     lm.write_image(f"scan/pat_{k}.png", np.full((4, 4), 50 * k, np.uint8))
    ...     lm.write_image(f"scan/frameSeq_0{k}.png", np.full((6, 6), 40 * k, np.uint8))
    >>> lm.convert("scan", "capture")
    'SLStudio'
    >>> lm.Capture.open("capture").camera_shape
    (6, 6)
    """
    if channel not in COLOURS:
        raise InputError(f"a channel {channel!r}", hint=f"use one of {', '.join(COLOURS)}")
    layout = find_layout(folder)
    number = list(COLOURS).index(channel)
    shown: dict[Path, NDArray[np.float32]] = {}
    for file in layout.patterns:
        if file not in shown:
            image = _one_channel(read_image(file), number)
            shown[file] = np.asarray(image / _top(file, image), np.float32)
    shapes = {image.shape for image in shown.values()}
    if len(shapes) > 1:
        raise InputError(
            f"{folder}: patterns of {len(shapes)} sizes", hint="give patterns of one size"
        )
    patterns = ImagePatterns(np.stack([shown[file] for file in layout.patterns]))
    first = _one_channel(read_image(layout.frames[0]), number)
    bits = 8 if _top(layout.frames[0], first) == np.iinfo(np.uint8).max else 16

    def frames() -> Any:
        for done, file in enumerate(layout.frames, start=1):
            yield _one_channel(read_image(file), number)
            if progress is not None:
                progress(done, len(layout.frames))

    exposures = np.asarray(layout.exposures)
    sensor = Sensor(exposures if np.ptp(exposures) else float(exposures[0]), bits=bits)
    write_capture(
        output,
        patterns,
        frames(),
        sensor=sensor,
        response=response,
        provenance={"converted_from": layout.name},
        overwrite=overwrite,
    )
    return layout.name


def _one_channel(image: NDArray[Any], number: int) -> NDArray[Any]:
    """The image itself if it is grey, or one of its channels."""
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., number])


def _top(file: Path, image: NDArray[Any]) -> int:
    """The highest level of an image of whole levels."""
    if image.dtype.kind != "u":
        raise InputError(
            f"{file}: holds {image.dtype} values", hint="convert images of 8 or 16 bits"
        )
    return int(np.iinfo(image.dtype).max)
