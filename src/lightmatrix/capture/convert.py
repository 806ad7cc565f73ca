"""`lm.convert`: captures of other programs as capture folders."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.folder import write_capture
from lightmatrix.capture.sensor import Sensor
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.images import READABLE, read_image
from lightmatrix.files.reading import parse_json, read_text
from lightmatrix.files.stacks import list_images, natural_order
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.ranges import as_float, as_path

# Folders of other programs that hold patterns and photographs, and how they lie in them.
#
# - CompenNet and its successors: `cam/raw/train` holds photographs, and `train`, in a folder above,
# the pictures that were projected.
# - SLStudio: one folder holds the frames, `frameSeq_00.bmp`, and the patterns, `pat_0.png`.
# - Brackets: a numbered folder for each pattern holds its photographs at several exposures;
# `exposures.json` or `exposures.csv` lists these.


@dataclass(frozen=True)
class Layout:
    """Files of a capture: a pattern and an exposure for each frame, all in one order."""

    name: str
    patterns: Sequence[Path]
    frames: Sequence[Path]
    # In any unit; one stands for all.
    exposures: Sequence[float] = (1.0,)


def find_layout(folder: str | Path) -> Layout:
    """How patterns and frames lie in a folder; an InputError if in no known way, or some lack."""
    place = as_path(folder)
    if not place.is_dir():
        raise InputError(f"{place}: no such folder", hint="check the name")
    for read in (_compennet, _slstudio, _brackets):
        layout = read(place)
        if layout is None:
            continue
        if len(layout.patterns) != len(layout.frames):
            raise InputError(
                f"{place}: {layout.name} with {len(layout.patterns)} patterns, but "
                f"{len(layout.frames)} frames",
                hint="is one missing?",
            )
        return layout
    raise InputError(
        f"{place}: has none of the layouts that can be converted",
        hint="CompenNet's (cam/raw/train), SLStudio's (frameSeq_*, pat_*), or numbered folders "
        "beside patterns/ and exposures.csv",
    )


def _compennet(place: Path) -> Layout | None:
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
    patterns, frames = (
        sorted(
            (file for file in place.glob(f"{prefix}*") if file.suffix.lower() in READABLE),
            key=natural_order,
        )
        for prefix in ("pat_", "frameSeq_")
    )
    if not frames:
        return None
    if not patterns:
        raise InputError(
            f"{place}: has frames (frameSeq_*), but not their patterns (pat_0.png, ...)",
            hint="let SLStudio write them, or copy them there",
        )
    return Layout("SLStudio", patterns, frames)


def _brackets(place: Path) -> Layout | None:
    folders = sorted(
        (entry for entry in place.iterdir() if entry.is_dir() and entry.name.isdecimal()),
        key=lambda entry: int(entry.name),
    )
    if not folders or not (place / "patterns").is_dir():
        return None
    patterns = list_images(place / "patterns")
    if len(patterns) != len(folders):
        raise InputError(
            f"{place}: has {len(patterns)} patterns, but {len(folders)} numbered folders",
            hint="give one folder of photographs for each pattern",
        )
    table = _exposures(place)
    shown, frames, exposures = [], [], []
    for pattern, folder in zip(patterns, folders, strict=True):
        for number, file in enumerate(list_images(folder)):
            known = table.get(file.name, table.get(file.stem, table.get(str(number))))
            if known is None:
                raise InputError(
                    f"{file}: has no exposure in {place / 'exposures'}.json or .csv",
                    hint="list each file name with its exposure, or one exposure a photograph",
                )
            shown.append(pattern)
            frames.append(file)
            exposures.append(known)
    return Layout("brackets", shown, frames, exposures)


def _exposures(place: Path) -> dict[str, float]:
    """Exposures by file name; or by the number of the photograph, if the file only lists them."""
    sources = [file for end in ("json", "csv") if (file := place / f"exposures.{end}").is_file()]
    if len(sources) != 1:
        raise InputError(
            f"{place}: has {'both' if sources else 'neither'} exposures.json and exposures.csv",
            hint="list each file name with its exposure in one of them",
        )
    file = sources[0]
    text = read_text(file)
    try:
        content = parse_json(text, str(file)) if file.suffix == ".json" else _columns(text)
        pairs = list(content.items() if isinstance(content, dict) else enumerate(content))
        table = {str(name): float(value) for name, value in pairs}
    except (ValueError, TypeError, OverflowError, csv.Error) as error:
        raise InputError(
            f"{file}: is no list of exposures: {error!s:.200}",
            hint='write file names and numbers, such as "a.png",0.5',
        ) from error
    if not table or not all(0 < value < float("inf") for value in table.values()):
        raise InputError(f"{file}: holds an exposure that is not above 0", hint="correct it")
    return table


def _columns(text: str) -> dict[str, str] | list[str]:
    """Names and exposures, or exposures alone, of a table; a ValueError says why it is none."""
    rows = [[field.strip() for field in row] for row in csv.reader(text.splitlines()) if row]
    # A first line without a number names the columns.
    heads = rows.pop(0) if rows and math.isnan(as_float(rows[0][-1])) else []
    widths = {len(row) for row in rows}
    if not widths <= {1} and not widths <= {2}:
        raise ValueError("its lines do not all have one column, or two; write 0.5 with a point")
    if widths != {2}:
        return [row[0] for row in rows]
    if len(heads) < 2 and all(field.isdecimal() for row in rows for field in row):
        raise ValueError("two columns of whole numbers, or decimal commas: write 0.5 with a point")
    names, values = zip(*rows, strict=True)
    if len(set(names)) < len(names):
        raise ValueError("it names a photograph twice")
    return dict(zip(names, values, strict=True))


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
