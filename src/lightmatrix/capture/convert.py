"""`lm.convert`: captures of other programs as capture folders."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.images import READABLE, read_image
from lightmatrix.files.reading import read_text
from lightmatrix.files.stacks import list_images, natural_order
from lightmatrix.paths import as_path
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.progress import Progress
from lightmatrix.ranges import as_float


class Layout(NamedTuple):
    """Files of a capture: a pattern and an exposure for each frame, all in one order."""

    name: str
    patterns: Sequence[Path]
    frames: Sequence[Path]
    # In any unit; one stands for all.
    exposures: Sequence[float] = (1.0,)


def find_layout(place: Path) -> Layout:
    """How patterns and frames lie in a folder; an InputError if in no known way, or some lack."""
    if not place.is_dir():
        raise InputError(f"{place}: no such folder", hint="check the name")
    layout = _compennet(place) or _slstudio(place) or _brackets(place)
    if layout is None:
        raise InputError(
            f"{place}: has none of the layouts that can be converted",
            hint="CompenNet's (cam/raw/train), SLStudio's (frameSeq_*, pat_*), or numbered folders "
            "beside patterns/ and exposures.csv",
        )
    if len(layout.patterns) != len(layout.frames):
        raise InputError(
            f"{place}: {layout.name} with {len(layout.patterns)} patterns, but "
            f"{len(layout.frames)} frames",
            hint="is one missing?",
        )
    return layout


def _compennet(place: Path) -> Layout | None:
    """CompenNet and its successors: photographs, and the pictures in a folder above."""
    frames = place / "cam" / "raw" / "train"
    if not frames.is_dir():
        return None
    # The pictures lie up to four folders above a setup: light, position, surface, cam.
    for above in (place / "prj" / "raw", place, *place.resolve().parents[:4]):
        if (above / "train").is_dir():
            return Layout("CompenNet", list_images(above / "train"), list_images(frames))
    raise InputError(
        f"{place}: has cam/raw/train, but no folder above holds train/, the projected pictures",
        hint="keep the folders as the data set has them",
    )


def _slstudio(place: Path) -> Layout | None:
    """SLStudio: one folder holds the frames, `frameSeq_00.bmp`, and the patterns, `pat_0.png`."""
    patterns, frames = (
        sorted((f for f in place.glob(name) if f.suffix.lower() in READABLE), key=natural_order)
        for name in ("pat_*", "frameSeq_*")
    )
    return Layout("SLStudio", patterns, frames) if frames else None


def _brackets(place: Path) -> Layout | None:
    """A numbered folder for each pattern, with its photographs at several exposures."""
    folders = [entry for entry in place.iterdir() if entry.is_dir() and entry.name.isdecimal()]
    if not folders or not (place / "patterns").is_dir():
        return None
    patterns = list_images(place / "patterns")
    if len(patterns) != len(folders):
        raise InputError(
            f"{place}: has {len(patterns)} patterns, but {len(folders)} numbered folders",
            hint="give one folder of photographs for each pattern",
        )
    listed = place / "exposures.csv"
    table, shown, frames, exposures = _exposures(listed), [], [], []
    for pattern, folder in zip(patterns, sorted(folders, key=natural_order), strict=True):
        for file in list_images(folder):
            if file.name not in table:
                hint = "list each file name with its exposure, such as a.png,0.5"
                raise InputError(f"{file}: has no exposure in {listed}", hint=hint)
            shown.append(pattern)
            frames.append(file)
            exposures.append(table[file.name])
    return Layout("brackets", shown, frames, exposures)


def _exposures(file: Path) -> dict[str, float]:
    """Exposures by file name, from a table of two columns; its first line may name them."""
    try:
        rows = [
            [field.strip() for field in row] for row in csv.reader(read_text(file).splitlines())
        ]
    except csv.Error as error:
        raise InputError(f"{file}: is no table: {error}", hint="write it anew") from error
    if rows and np.isnan(as_float(rows[0][-1] if rows[0] else "")):
        rows = rows[1:]
    table = {row[0]: as_float(row[1]) for row in rows if len(row) == 2}
    if not table or len(table) < len(rows) or not all(0 < e < np.inf for e in table.values()):
        raise InputError(
            f"{file}: is no list of exposures above 0, each with the name of its photograph",
            hint="write one name and one number a line, such as a.png,0.5",
        )
    return table


def convert(
    folder: str | Path,
    output: str | Path,
    *,
    channel: str = "green",
    response: str = "linear",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> str:
    """Write a capture folder from patterns and photographs in the layout of another program.

    Parameters
    ----------
    folder : str or Path
        A setup of CompenNet's data (it holds cam/raw/train; the pictures are in train/, up to four
        folders above); a folder of SLStudio's frames (frameSeq_*) and patterns (pat_*); or a
        folder with patterns/, a numbered folder of photographs for each pattern, and their
        exposures in exposures.csv.
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
    layout, number = find_layout(as_path(folder)), COLOURS.index(channel)
    shown: dict[Path, NDArray[np.float32]] = {}
    for file in layout.patterns:
        if file not in shown:
            image = _one_channel(read_image(file), number)
            shown[file] = np.asarray(image / _top(file, image), np.float32)
    shapes = {image.shape for image in shown.values()}
    if len(shapes) > 1:
        hint = "give patterns of one size"
        raise InputError(f"{folder}: patterns of {len(shapes)} sizes", hint=hint)
    patterns = ImagePatterns(np.stack([shown[file] for file in layout.patterns]))
    first = _one_channel(read_image(layout.frames[0]), number)
    bits = 8 if _top(layout.frames[0], first) == np.iinfo(np.uint8).max else 16

    def frames() -> Iterator[NDArray[Any]]:
        for done, file in enumerate(layout.frames, start=1):
            yield _one_channel(read_image(file), number)
            if progress is not None:
                progress(done, len(layout.frames))

    exposures = np.asarray(layout.exposures)
    sensor = Sensor(exposures if np.ptp(exposures) else float(exposures[0]), bits=bits)
    write_capture(
        output, patterns, frames(), sensor=sensor, response=response,
        provenance={"converted_from": layout.name}, overwrite=overwrite,
    )  # fmt: skip
    return layout.name


def _one_channel(image: NDArray[Any], number: int) -> NDArray[Any]:
    return image if image.ndim == 2 else np.ascontiguousarray(image[..., number])


def _top(file: Path, image: NDArray[Any]) -> int:
    """The highest level of an image of whole levels."""
    if image.dtype.kind != "u":
        hint = "convert images of 8 or 16 bits"
        raise InputError(f"{file}: holds {image.dtype} values", hint=hint)
    return int(np.iinfo(image.dtype).max)
