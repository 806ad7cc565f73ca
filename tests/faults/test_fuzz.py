"""Mutations of everything that is read: it is refused with words, or read rightly.

45 at each run of the tests; `make fuzz` does 20,000, FUZZ=500 in the environment 500.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from scipy import sparse

from lightmatrix.files.images import encode_image

from .case import Case, bear
from .checks import if_accepted, whole_matrix
from .run import Limits, Ran, SkipError, run
from .test_partial import PARTIAL, interrupted
from .work import TILED, fresh_copy

Generator = np.random.Generator
# A damage says in words what it did.
Damage = Callable[[Generator, Path], str]


# ---- ways to damage a file: by its bytes, as a whole, or by what it means


def in_bytes(draw: Generator, file: Path) -> str:
    """A bit turned round, the end lost, bytes too many, or zeros, as a bad sector leaves."""
    data = file.read_bytes()
    at, count = int(draw.integers(max(1, len(data)))), int(draw.integers(1, 9))
    before, after = data[:at], data[at:]
    how = str(draw.choice(["flip", "flip", "cut", "insert", "blank"]))
    changed = {
        "flip": bytes([byte ^ 1 << (count - 1) for byte in after[:1]]) + after[1:],
        "cut": b"",
        "insert": draw.bytes(count) + after,
        "blank": bytes(min(8 * count, len(after))) + after[8 * count :],
    }
    file.write_bytes(before + changed[how])
    return f"{how} ({count}) at byte {at} of {len(data)}"


def as_a_whole(draw: Generator, file: Path) -> str:
    """It is gone, or another thing than a file."""
    file.unlink()
    how = str(draw.choice(["lost", "lost", "folder", "pipe", "link to nowhere", "link to itself"]))
    if how == "folder":
        file.mkdir()
    elif how == "pipe":
        os.mkfifo(file)
    elif how != "lost":
        file.symlink_to("nowhere" if "nowhere" in how else file.name)
    return how


ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 0.5, 1e300, -1e300, 2**31, 2**63, 2**64, 10**30),
    *(float("nan"), float("inf"), "", "text", "[/red]", ":x:", "2", "../x.png", "\0", "é" * 50),
    *([], {}, [1], [0, 0], [8, 8], [-8, 8], [2**40, 2**40], [[8], [8]], {"a": 1}, [None], ["8", 8]),
)


def in_json(draw: Generator, file: Path) -> str:
    """One value, somewhere, becomes another; or a key is renamed or lost."""
    content = json.loads(file.read_text())
    places = list(_places(content))
    holder, key = places[int(draw.integers(len(places)))]
    how = int(draw.integers(8))
    value = ODD[int(draw.integers(len(ODD)))]
    if how > 5 and isinstance(holder, dict):
        value = holder.pop(key)
        if how == 6:
            holder[f"{key}s"] = value
        words = f"{key} lost or renamed"
    else:
        if how == 5:
            other, place = places[int(draw.integers(len(places)))]
            value = json.loads(json.dumps(other[place]))
        holder[key] = value
        words = f"{key} = {str(value)[:30]}"
    file.write_text(json.dumps(content))
    return words


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    items = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in list(items):
        yield content, key
        if isinstance(value, (dict, list)):
            yield from _places(value)


# ---- what is damaged


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


def _any_file(draw: Generator, place: Path) -> str:
    """One file of a folder damaged in any way."""
    files = sorted(file for file in place.rglob("*") if file.is_file())
    file = files[int(draw.integers(len(files)))]
    if file.suffix == ".json" and draw.random() < 0.5:
        damage: Damage = in_json
    else:
        damage = in_bytes if draw.random() < 0.7 else as_a_whole
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
    names = ("capture.json", "capture.json", "patterns/patterns.json", "")
    name = names[int(draw.integers(len(names)))]
    if not name:
        return _any_file(draw, folder / "capture")
    return f"{name}: {in_json(draw, folder / 'capture' / name)}"


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
    words = in_bytes(draw, file)
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


def _archive(draw: Generator, folder: Path) -> str:
    return f"T.npz: {in_bytes(draw, folder / 'T.npz')}"


def _partial(draw: Generator, folder: Path) -> str:
    interrupted(folder)
    return _any_file(draw, folder / PARTIAL)


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
        bear(case, place)
