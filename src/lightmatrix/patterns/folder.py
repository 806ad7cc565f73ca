"""Pattern sets as folders of PNG files, with patterns.json to remake the operator.

A Bernoulli or Hadamard set is read back as the fast operator that it was written from if the images
show the same patterns. If they differ, the images are used: they are what was projected.
"""

import csv
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError, warn
from lightmatrix.files import images as image_files
from lightmatrix.files.colours import COLOURS
from lightmatrix.files.kinds import PATTERNS
from lightmatrix.files.reading import errors_naming, read_json
from lightmatrix.files.stacks import ImageStack, Page, list_entries
from lightmatrix.files.writing import atomic_folder
from lightmatrix.paths import as_path
from lightmatrix.patterns.bits import BitPatterns
from lightmatrix.patterns.colour import ColourPatterns, colour_images
from lightmatrix.patterns.making import remake_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet, to_grey
from lightmatrix.resources.memory import check_memory
from lightmatrix.resources.threads import work_ahead

DESCRIPTION = "patterns.json"
# Every patterns.json states its format and version; a later version is refused.
FORMAT, VERSION = "lightmatrix-patterns", 1


def write_patterns(
    folder: str | Path,
    patterns: PatternSet,
    *,
    colour: str | None = None,
    bit_planes: str | None = None,
    overwrite: bool = False,
) -> None:
    """Write a pattern set as 8-bit PNG files and patterns.json.

    Parameters
    ----------
    folder : str or Path
        The folder to make, whole or not at all.
    patterns : PatternSet
        K patterns, written as pattern_0000.png, pattern_0001.png, ...
    colour : {"red", "green", "blue"}, optional
        The primary of a colour projector to show them in; None: white, or the colours that the
        patterns have.
    bit_planes : str, optional
        Also write the folder bit_planes: black and white patterns as the bits of colour images, 24
        in each, for boards with micromirrors. It says in which order the board shows the primaries,
        the lowest bit first: "grb" for TI's LightCrafter 4500. sequence.csv lists the image and the
        number of the bit plane of each pattern.
    overwrite : bool
        Whether an existing folder of patterns may be replaced.

    Raises
    ------
    InputError
        On another colour or order, and on bit planes of patterns that are not black and white.
    OutputError
        If the folder exists, was not written by lightmatrix, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_patterns("written", lm.BernoulliPatterns((8, 8), 4))
    """
    if colour is not None and colour not in COLOURS:
        raise InputError(f"patterns in {colour!r}", hint=f"use {', '.join(COLOURS)}")
    if colour is not None and isinstance(patterns, ColourPatterns):
        hint = "leave out one of the two"
        raise InputError(f"patterns in colour, to be written in {colour}", hint=hint)
    if bit_planes is not None:
        check_order(patterns, bit_planes)
    with atomic_folder(folder, PATTERNS, overwrite=overwrite) as part:
        fill_pattern_folder(part, patterns, colour)
        if bit_planes is not None:
            fill_bit_planes(part / "bit_planes", patterns, bit_planes)


def fill_pattern_folder(folder: Path, patterns: PatternSet, colour: str | None = None) -> None:
    """Write the files of a pattern folder into an empty folder."""
    digits = max(4, len(str(patterns.count - 1)))
    primary = np.array([name == colour for name in COLOURS], np.uint8)

    def write(k: int) -> None:
        image = patterns.greys(k, k + 1)[0]
        if isinstance(patterns, ColourPatterns):
            image = np.stack(np.split(image, 3, axis=1), axis=-1)
        coloured = image if colour is None else image[..., None] * primary
        image_files.fill_image(folder / f"pattern_{k:0{digits}d}.png", coloured)

    for _ in work_ahead(write, range(patterns.count)):
        pass
    header = {"format": FORMAT, "version": VERSION, "digest": patterns.digest}
    content = {**header, "description": patterns.description}
    (folder / DESCRIPTION).write_text(json.dumps(content, indent=2) + "\n")


def read_patterns(source: str | Path) -> PatternSet:
    """Read a folder of pattern images in natural order, or a file that holds several.

    Parameters
    ----------
    source : str or Path
        The folder; or a TIFF of several pages, an npy or npz file of (K, rows, cols).

    Returns
    -------
    PatternSet
        The operator that patterns.json describes, if the images agree with it. Else, with a
        warning, or without patterns.json, the images themselves: as bits if all of them are black
        and white, which is as fast. `ColourPatterns` if one of them shows several colours.

    Raises
    ------
    InputError
        On images that cannot be read, or that differ in size or colour, on integers of 0 and 1
        only, and on a damaged patterns.json.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.write_patterns("patterns", lm.BernoulliPatterns((8, 8), 4))
    >>> lm.read_patterns("patterns")
    BernoulliPatterns(shape=(8, 8), count=4, density=0.5, seed=0)
    """
    place = as_path(source)
    if (place / "patterns").is_dir():
        raise InputError(f"{place}: is a capture", hint=f"its patterns are in {place / 'patterns'}")
    entries = list_entries(place)
    # A stack in one file was not written from an operator.
    paths = [entry for entry in entries if isinstance(entry, Path)]
    file, difference = place / DESCRIPTION, None
    # A dangling link is an error, not a folder without a description.
    if paths and os.path.lexists(file):
        description = read_json(file, FORMAT, VERSION).get("description")
        if not isinstance(description, dict):
            hint = "remove it to read the patterns from their images"
            raise InputError(f"{file}: holds no description of the patterns", hint=hint)
        # Patterns of another size might take all memory.
        size = [*image_files.read_image(paths[0]).shape[:2]]
        if description.get("kind") != PatternSet.kind:
            if description.get("count", len(paths)) != len(paths):
                difference = f"its {len(paths)} images are not"
            elif description.get("shape", size) != size:
                difference = f"{paths[0].name} is not among"
        with errors_naming(file):
            operator = None if difference else remake_patterns(description)
        if operator is not None:
            difference = _first_difference(operator, paths)
            if difference is None:
                return operator
    if difference is not None:
        warn(
            f"{place}: {difference} the patterns that {DESCRIPTION} describes; the images are used"
        )
    return _from_images(place, entries)


def _from_images(place: Path, entries: list[Path | Page]) -> PatternSet:
    """The patterns that the images show, as bits unless one of them has a grey pixel."""
    stack = ImageStack.open(entries)
    shape, count = (stack.shape[0], stack.shape[1]), len(entries)
    if len(stack.shape) == 3 and any(
        image.any(axis=(0, 1)).sum() > 1 and not image_files.is_grey(image)
        for image in work_ahead(stack.read, range(count))
    ):
        # A pattern of more than one colour is one of a colour projector.
        check_memory(place, 4 * count * int(np.prod(stack.shape)))
        shown = np.empty((count, *stack.shape), np.float32)
        top = 1.0 if stack.dtype.kind == "f" else np.iinfo(stack.dtype).max
        for k, image in enumerate(work_ahead(stack.read, range(count))):
            shown[k] = image / np.float32(top)
        _check_depth(place, stack.dtype, float(shown.max()))
        return colour_images(shown)
    pixels = shape[0] * shape[1]
    bits = np.empty((count, (pixels + 7) // 8), np.uint8)
    images: NDArray[np.float32] | None = None
    brightest = 0.0
    for k, grey in enumerate(_greys(entries, work_ahead(stack.read, range(count)))):
        brightest = max(brightest, float(grey.max()))
        if images is None:
            lit = grey == 1
            if (lit | (grey == 0)).all():
                bits[k] = np.packbits(lit, bitorder="little")
                continue
            check_memory(place, 4 * count * pixels)
            images = np.empty((count, *shape), np.float32)
            images[:k] = BitPatterns(shape, bits).images(0, k)
        images[k] = grey
    if stack.dtype.kind == "u" and 0 < brightest <= 1.01 / np.iinfo(stack.dtype).max:
        raise InputError(
            f"{place}: no pattern is brighter than 1 of {np.iinfo(stack.dtype).max}",
            hint="save zeros and ones as 0 and 255, or as bool or float",
        )
    _check_depth(place, stack.dtype, brightest)
    return BitPatterns(shape, bits) if images is None else ImagePatterns(images)


def _check_depth(place: Path, dtype: np.dtype[Any], brightest: float) -> None:
    """Refuse 16-bit files of fewer bits: for 0 and 255, T would be 257 times too large."""
    top = round(brightest * 65535)
    if top and (likely := image_files.likely_white(dtype, top)) is not None:
        raise InputError(
            f"{place}: the patterns have 16 bits, but no level above {top}: was {likely} shown as "
            "white?",
            hint=f"save them with 8 bits, or with {likely} as 65535; patterns that were this dark "
            "can be saved as float, in [0, 1]",
        )


def _greys(
    entries: Sequence[Path | Page], images: Iterable[NDArray[Any]]
) -> Iterator[NDArray[np.float32]]:
    """The grey values of patterns, which must all be shown in one colour."""
    first: tuple[Path | Page, str] | None = None
    for entry, image in zip(entries, images, strict=True):
        grey, colour = image_files.as_grey(str(entry), image), image_files.colour_of(image)
        if colour and first is None:
            first = entry, colour
        if colour and first is not None and colour != first[1]:
            raise InputError(
                f"{entry}: is {colour}, but {first[0].name} is {first[1]}",
                hint="a colour projector is three projectors: put the patterns of each colour, and "
                "their photographs, into a folder of their own",
            )
        yield grey


def _first_difference(operator: PatternSet, paths: list[Path]) -> str | None:
    """How the images differ from an operator, in words; None if they do not."""
    if len(paths) != operator.count:
        return f"its {len(paths)} images are not"
    for k, grey in enumerate(_greys(paths, work_ahead(image_files.read_image, paths))):
        if not np.array_equal(to_grey(grey), operator.greys(k, k + 1)[0]):
            return f"{paths[k].name} is not among"
    return None


# Bit planes of colour images, for boards with micromirrors. Such a board shows each of the 24 bits
# of a colour image by itself, thousands in a second. It is told by number which one comes next.

# The first letters of the primaries, as they stand in a file.
_CHANNELS = "rgb"
_BITS = 8


def check_order(patterns: PatternSet, order: str) -> None:
    """Refuse an order of the primaries that names not each once, and patterns in grey or colour."""
    if sorted(order) != sorted(_CHANNELS):
        hint = "use grb for TI's LightCrafter 4500, or rgb, bgr, ... for other boards"
        raise InputError(f"bit planes in the order {order!r}", hint=hint)
    grey = any(((image > 0) & (image < 1)).any() for _, image in patterns.chunks())
    if grey or isinstance(patterns, ColourPatterns):
        hint = "use black and white ones, such as bernoulli"
        raise InputError(f"bit planes of patterns in {'grey' if grey else 'colour'}", hint=hint)


def fill_bit_planes(folder: Path, patterns: PatternSet, order: str) -> None:
    """Write colour images planes_00.png, ... and sequence.csv, which says where each pattern is.

    The first eight patterns are the bits of the primary that `order` names first, the lowest bit
    first, the next eight those of the second.
    """
    folder.mkdir()
    step = len(order) * _BITS
    rows = []
    for start in range(0, patterns.count, step):
        planes = np.zeros((*patterns.shape, len(order)), np.uint8)
        name = f"planes_{start // step:02d}.png"
        for number, k in enumerate(range(start, min(start + step, patterns.count))):
            primary, bit = order[number // _BITS], number % _BITS
            lit = patterns.images(k, k + 1)[0] > 0
            planes[..., _CHANNELS.index(primary)] |= lit.astype(np.uint8) << bit
            rows.append((k, name, number, f"{primary.upper()}{bit}"))
        image_files.fill_image(folder / name, planes)
    with (folder / "sequence.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("pattern", "image", "plane", "bit"))
        writer.writerows(rows)
