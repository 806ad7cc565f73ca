"""Faults to put into a work folder; most of them make a function of the folder."""

from __future__ import annotations

import functools
import json
import os
import shutil
import stat
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from lightmatrix.files.zarr_arrays import SMALL
from lightmatrix.transport.store import seal

from .case import Prepare
from .run import SkipError

Given = ParamSpec("Given")
Change = Callable[[NDArray[Any]], NDArray[Any]]


def fault(put: Callable[Concatenate[Path, Given], None]) -> Callable[Given, Prepare]:
    """Make of a function a maker of faults: its other arguments come first, the folder later."""

    @functools.wraps(put)
    def made(*given: Given.args, **named: Given.kwargs) -> Prepare:
        return lambda folder: put(folder, *given, **named)

    return made


@fault
def both(folder: Path, *faults: Prepare) -> None:
    """Several faults, one after the other."""
    for one in faults:
        one(folder)


# ---- files and what is not one


@fault
def text(folder: Path, name: str, content: str | bytes = "not what it should be") -> None:
    """A file with that content."""
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content.encode() if isinstance(content, str) else content)


@fault
def remove(folder: Path, name: str) -> None:
    """No such file or folder any more."""
    place = folder / name
    if place.is_dir() and not place.is_symlink():
        shutil.rmtree(place)
    else:
        place.unlink(missing_ok=True)


@fault
def copy(folder: Path, source: str, target: str) -> None:
    """A copy of a file or folder."""
    if (folder / source).is_dir():
        shutil.copytree(folder / source, folder / target)
    else:
        (folder / target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / source, folder / target)


def move(source: str, target: str) -> Prepare:
    """Another name."""
    return lambda folder: (folder / source).rename(folder / target)


def folder_at(name: str) -> Prepare:
    """An empty folder where a file is expected."""
    return both(remove(name), lambda folder: (folder / name).mkdir(parents=True))


def link(name: str, target: str) -> Prepare:
    """A symbolic link in place of what is there."""
    return both(remove(name), lambda folder: (folder / name).symlink_to(target))


def pipe(name: str) -> Prepare:
    """A named pipe that nobody writes to."""
    return both(remove(name), lambda folder: os.mkfifo(folder / name))


def device(name: str, minor: int = 3) -> Prepare:
    """A device node of our own: 3 is the null device's, 5 that of endless zeros."""

    def fault(folder: Path) -> None:
        try:
            os.mknod(folder / name, 0o666 | stat.S_IFCHR, os.makedev(1, minor))
            with open(folder / name, "rb"):
                pass
        except OSError as error:
            raise SkipError(f"no right to make a device ({error.strerror})") from error

    return both(remove(name), fault)


@fault
def cut(folder: Path, name: str, size: int) -> None:
    """Only the first bytes of a file."""
    (folder / name).write_bytes((folder / name).read_bytes()[:size])


@fault
def flip(folder: Path, name: str, position: float, bit: int = 0) -> None:
    """One bit of a file turned round, at a share of its length."""
    data = bytearray((folder / name).read_bytes())
    data[min(len(data) - 1, int(position * len(data)))] ^= 1 << bit
    (folder / name).write_bytes(bytes(data))


# ---- JSON


@fault
def json_at(folder: Path, name: str, *path: str, value: Any) -> None:
    """One value of a JSON file set; the path leads to it."""
    file = folder / name
    content = json.loads(file.read_text())
    inner = content
    for key in path[:-1]:
        inner = inner.setdefault(key, {})
    inner[path[-1]] = value
    file.write_text(json.dumps(content))


@fault
def json_edit(folder: Path, name: str, edit: Callable[[dict[str, Any]], None]) -> None:
    """A JSON file changed by a function."""
    content = json.loads((folder / name).read_text())
    edit(content)
    (folder / name).write_text(json.dumps(content))


def described(**content: Any) -> Prepare:
    """Keys of capture/capture.json set."""
    return json_edit("capture/capture.json", lambda held: held.update(content))


DEEP = "[" * 100_000 + "]" * 100_000


# ---- images


def array(name: str, values: NDArray[Any]) -> Prepare:
    """An .npy file."""
    return lambda folder: np.save(folder / name, values, allow_pickle=True)


def chunk(kind: bytes, data: bytes) -> bytes:
    """A PNG chunk with its checksum."""
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def png(
    shape: tuple[int, int], depth: int, colour: int, pixels: bytes, *extra: bytes, level: int = 6
) -> bytes:
    """A PNG file of bare scan lines, each with its filter byte."""
    header = struct.pack(">IIBBBBB", shape[1], shape[0], depth, colour, 0, 0, 0)
    return b"".join(
        (
            b"\x89PNG\r\n\x1a\n",
            chunk(b"IHDR", header),
            *extra,
            chunk(b"IDAT", zlib.compress(pixels, level)),
            chunk(b"IEND", b""),
        )
    )


def endless_zeros(count: int) -> bytes:
    """A zlib stream of so many zeros, made without compressing them all."""
    block = 1 << 24
    maker = zlib.compressobj(9, zlib.DEFLATED, -15)
    head = maker.compress(bytes(block)) + maker.flush(zlib.Z_FULL_FLUSH)
    again = maker.compress(bytes(block)) + maker.flush(zlib.Z_FULL_FLUSH)
    rest = zlib.compressobj(9, zlib.DEFLATED, -15)
    blocks, left = divmod(count, block)
    tail = rest.compress(bytes(left)) + rest.flush()
    body = head + again * (blocks - 1) if blocks else b""
    checksum = (count % 65521) << 16 | 1
    return b"\x78\xda" + body + tail + struct.pack(">I", checksum)


# ---- stores and archives


def rewrite(store: Path, name: str, values: NDArray[Any]) -> None:
    """One array of a Zarr store written anew, with sound checksums and a sound seal."""
    group = zarr.open_group(store, mode="r+", use_consolidated=False)
    del group[name]
    made = group.create_array(
        name,
        shape=values.shape,
        chunks=tuple(max(1, n) for n in values.shape),
        dtype=values.dtype,
        compressors=[BloscCodec(**SMALL), Crc32cCodec()],
        config={"write_empty_chunks": True},
    )
    made[...] = values
    # Arrays that no store may hold cannot be sealed either.
    with suppress(ValueError):
        seal(store)


@fault
def stored(
    folder: Path, name: str, array_name: str, change: Callable[[NDArray[Any]], NDArray[Any]]
) -> None:
    """One array of a store changed by a function."""
    group = zarr.open_group(folder / name, mode="r", use_consolidated=False)
    held = group[array_name]
    assert isinstance(held, zarr.Array)
    rewrite(folder / name, array_name, change(np.asarray(held[...])))


def attribute(name: str, key: str, value: Any) -> Prepare:
    """One attribute of a store set."""
    return json_at(f"{name}/zarr.json", "attributes", key, value=value)


@fault
def packed(folder: Path, /, name: str, **changed: Any) -> None:
    """Keys of an npz file set by a function of the old value or a value; None leaves one out."""
    with np.load(folder / name, allow_pickle=False) as held:
        content: dict[str, Any] = {key: held[key] for key in held.files}
    for key, value in changed.items():
        if value is None:
            content.pop(key, None)
        else:
            content[key] = value(content[key]) if callable(value) else value
    np.savez(folder / name, **content)


def with_item(index: int, value: Any) -> Change:
    """A change of one item of an array."""

    def change(values: NDArray[Any]) -> NDArray[Any]:
        result = values.copy()
        result.ravel()[index] = value
        return result

    return change
