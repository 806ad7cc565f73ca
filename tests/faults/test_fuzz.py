"""Mutations of everything that is read: it is refused with words, or read rightly.

45 at each run of the tests; `make fuzz` does 20,000, FUZZ=500 in the environment 500.
"""

from __future__ import annotations

import io
import os
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy import sparse

from lightmatrix.files.images import encode_image

from .case import Case, complaint_of
from .checks import if_accepted, whole_matrix
from .mutate import (
    BYTES,
    FILES,
    Damage,
    Generator,
    change_json,
    flip_bit,
)
from .run import Limits, Ran, SkipError, run
from .test_partial import PARTIAL, interrupted
from .work import TILED, fresh_copy


@dataclass(frozen=True)
class Subject:
    """Something that is read, with one of `commands`, once it is damaged.

    It is made of what it `needs` of the work folder. The command may make `makes`, and change
    `leaves` even if it is refused. `sane` says what is wrong with a result that was accepted.
    """

    needs: tuple[str, ...]
    damage: Damage
    commands: tuple[str, ...]
    makes: tuple[str, ...]
    sane: Callable[[Path, str], str | None]
    leaves: tuple[str, ...] = ()


def _pick(draw: Generator, items: Any) -> Any:
    ordered = sorted(items)
    return ordered[int(draw.integers(len(ordered)))]


def _any_file(draw: Generator, place: Path) -> str:
    """One file of a folder damaged in any way."""
    file = _pick(draw, [f for f in place.rglob("*") if f.is_file()])
    damages = (*BYTES, *FILES)
    damage = damages[int(draw.integers(len(damages)))]
    return f"{file.relative_to(place.parent)}: {damage(draw, file)}"


# ---- results


def _finite(folder: Path, words: str) -> str | None:
    """Whatever was made holds finite numbers only."""
    for file in folder.glob("out.*"):
        if file.suffix == ".npy":
            values = np.load(file)
        elif file.suffix == ".npz":
            values = sparse.load_npz(file).data
        elif file.suffix == ".zarr":
            values = whole_matrix(file)
        else:
            continue
        if not np.isfinite(values).all():
            return f"{file.name} holds numbers that are not finite"
    return None


# ---- captures


def _capture(draw: Generator, folder: Path) -> str:
    place = folder / "capture"
    how = int(draw.integers(10))
    if how < 5:
        file = place / "capture.json"
    elif how < 7:
        file = place / "patterns" / "patterns.json"
    else:
        return _any_file(draw, place)
    return f"{file.relative_to(folder)}: {change_json(draw, file)}"


# ---- images


def _images(draw: Generator, folder: Path) -> str:
    # Noise, so that every bit of the file counts.
    pixels = draw.integers(0, 256, (8, 8), dtype=np.uint8)
    kind = int(draw.integers(12))
    deep = pixels.astype(np.uint16) * 257
    colour = np.repeat(pixels[..., None], 3, axis=2)
    stream = io.BytesIO()
    if kind < 6:
        suffix = ".png"
        image = (pixels, deep, colour, pixels, deep, (pixels > 99).astype(np.uint8) * 255)[kind]
        stream.write(encode_image(image, "png"))
    elif kind < 9:
        suffix = ".tif"
        options: tuple[dict[str, Any], ...] = ({}, {"compression": "zlib"}, {"byteorder": ">"})
        tifffile.imwrite(stream, deep, **options[kind - 6])
    elif kind == 9:
        suffix = ".npy"
        np.save(stream, deep)
    else:
        suffix = (".bmp", ".jpg")[kind - 10]
        stream.write(encode_image(pixels, ("bmp", "jpeg")[kind - 10]))
    file = folder / "picture"
    file.write_bytes(stream.getvalue())
    (folder / f"sound{suffix}").write_bytes(stream.getvalue())
    damages = (*BYTES, flip_bit, flip_bit)
    words = damages[int(draw.integers(len(damages)))](draw, file)
    # The command names picture.png; the reader goes by what is in the file, or refuses.
    file.rename(folder / f"picture{suffix}")
    return f"picture{suffix}: {words}"


def _same_picture(folder: Path, words: str) -> str | None:
    """A PNG whose pixels are accepted after damage of any kind has its own pixels."""
    if not words.startswith("picture.png"):
        return _finite(folder, words)
    ran = run("relight one.zarr sound.png -o wanted.npy", folder)
    if ran.code != 0:
        return f"the sound picture is refused: {ran.err[:100]}"
    same = np.array_equal(np.load(folder / "out.npy"), np.load(folder / "wanted.npy"))
    (folder / "wanted.npy").unlink()
    return None if same else "a damaged PNG was read with other pixels"


# ---- stores


def _store(draw: Generator, folder: Path) -> str:
    place = folder / "scene.zarr"
    shutil.copytree(place, folder / "sound.zarr")
    # tests/transport/test_untrusted_matrices.py has arrays that are stored well and are wrong.
    if draw.random() < 0.5:
        file = _pick(draw, [place / "zarr.json", *place.rglob("zarr.json")])
        return f"{file.relative_to(folder)}: {change_json(draw, file)}"
    return _any_file(draw, place)


def _same_store(folder: Path, words: str) -> str | None:
    """Numbers are finite; bytes of a chunk that were damaged are noticed."""
    complaint = _finite(folder, words)
    if complaint or "/c/" not in words or "diagnostics" in words:
        return complaint
    try:
        read, wanted = (whole_matrix(folder / name) for name in ("scene.zarr", "sound.zarr"))
    except ValueError as error:
        return f"accepted by one command, not by another: {error}"
    return None if np.array_equal(read, wanted) else "a damaged chunk was read with other numbers"


# ---- archives


def _archive(draw: Generator, folder: Path) -> str:
    return f"T.npz: {BYTES[int(draw.integers(len(BYTES)))](draw, folder / 'T.npz')}"


# ---- partial runs


def _partial(draw: Generator, folder: Path) -> str:
    place = folder / PARTIAL
    interrupted(folder)
    file = _pick(draw, [f for f in place.iterdir() if f.is_file()])
    if file.suffix == ".json" and draw.random() < 0.5:
        return f"{file.name}: {change_json(draw, file)}"
    return _any_file(draw, place)


def _whole(folder: Path, words: str) -> str | None:
    """A run that goes on has the T of one that was never interrupted, whatever the damage."""
    same = np.array_equal(whole_matrix(folder / "new.zarr"), whole_matrix(folder / "dense.zarr"))
    return None if same else "a damaged tile was used as it is"


SUBJECTS: dict[str, Subject] = {
    "capture": Subject(
        ("capture",),
        _capture,
        ("estimate capture --no-coherent --iterations 3 -o out.zarr",),
        ("out.zarr",),
        _finite,
    ),
    "image": Subject(
        ("one.zarr",),
        _images,
        ("relight one.zarr picture{suffix} -o out.npy",),
        ("out.npy",),
        _same_picture,
    ),
    "store": Subject(
        ("scene.zarr", "shown.png", "T.npz"),
        _store,
        (
            "info scene.zarr --json",
            "relight scene.zarr shown.png -o out.npy",
            "export scene.zarr out.npz",
            "export scene.zarr out.mat",
            "evaluate scene.zarr --truth T.npz --json",
        ),
        ("out.npy", "out.npz", "out.mat"),
        _same_store,
    ),
    "archive": Subject(
        ("T.npz", "patterns", "scene.zarr"),
        _archive,
        (
            "simulate T.npz --patterns patterns -o out",
            "evaluate scene.zarr --truth T.npz --json",
            "plan T.npz --size 8x8 --json",
        ),
        ("out",),
        _finite,
    ),
    "partial": Subject(
        ("capture", "dense.zarr"),
        _partial,
        (f"{TILED} -o new.zarr",),
        ("new.zarr", PARTIAL),
        _whole,
        (PARTIAL,),
    ),
}
# Images and captures are read most often, and in most ways.
ORDER = ("image", "store", "capture", "archive", "image", "store", "partial", "capture", "archive")


@pytest.mark.parametrize("number", range(int(os.environ.get("FUZZ", "45"))))
def test_what_is_damaged_is_refused_or_read_rightly(number: int, template: Path) -> None:
    name = ORDER[number % len(ORDER)]
    subject = SUBJECTS[name]
    draw = np.random.default_rng([zlib.crc32(name.encode()), number])
    with fresh_copy(template, subject.needs) as place:
        try:
            words = subject.damage(draw, place)
        except SkipError as reason:
            pytest.skip(str(reason))
        command = subject.commands[int(draw.integers(len(subject.commands)))]
        picture = next(iter(place.glob("picture.*")), Path())
        command = command.replace("{suffix}", picture.suffix)

        def sane(folder: Path, ran: Ran) -> str | None:
            try:
                return subject.sane(folder, words)
            except ValueError as error:
                return str(error)

        case = Case(
            words,
            command,
            code=(0, 2, 3),
            makes=subject.makes,
            leaves=subject.leaves,
            check=if_accepted(sane),
            # An accidental decompression bomb exceeds the memory and ends with exit code 3.
            limits=Limits(memory=2 << 30),
        )
        complaint = complaint_of(case, place)
    if complaint:
        pytest.fail(f"{words}; `{command}`: {complaint}", pytrace=False)
