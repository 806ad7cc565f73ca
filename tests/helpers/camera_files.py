"""Writes raw files for tests: uncompressed TIFF with an RGGB mosaic, as two makers do."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Tags by number, each a kind and its values; kinds are struct's, and `text`, `bytes`, `rational`,
# `place` (bytes elsewhere, whose place the tag holds) and `folder` (a directory elsewhere).
Directory = dict[int, tuple[str, Any]]
_CODES = {"B": 1, "text": 2, "H": 3, "I": 4, "rational": 5, "bytes": 7}
SECONDS = (1, 50)


def write_nef(file: Path, levels: NDArray[Any], blacks: tuple[int, ...]) -> Path:
    """Write a Nikon file (NEF): 16 bits, four black levels in the maker note."""
    note = b"Nikon\0\x02\x10\0\0" + _tiff({0x1: ("bytes", b"0210"), 0x3D: ("H", blacks)})
    exif: Directory = {33434: ("rational", SECONDS), 37500: ("bytes", note)}
    return _write(file, b"NIKON CORPORATION\0", b"NIKON T1\0", _mosaic(levels), exif)


def write_arw(file: Path, levels: NDArray[Any], blacks: tuple[int, ...]) -> Path:
    """Write a Sony file (ARW): 14 of 16 bits, four black levels beside the image."""
    exif: Directory = {33434: ("rational", SECONDS)}
    mosaic = _mosaic(levels) | {0x7310: ("H", blacks)}
    return _write(file, b"SONY\0", b"ILCE-T1\0", mosaic, exif)


def _write(file: Path, make: bytes, model: bytes, mosaic: Directory, exif: Directory) -> Path:
    thumbnail = _image((8, 16), bytes(128), 8)
    camera = {271: ("text", make), 272: ("text", model), 330: ("folder", mosaic)}
    file.write_bytes(_tiff(thumbnail | camera | {34665: ("folder", exif)}))
    return file


def _mosaic(levels: NDArray[Any]) -> Directory:
    data = levels.astype("<u2").tobytes()
    cells: Directory = {33421: ("H", (2, 2)), 33422: ("B", (0, 1, 1, 2))}
    return _image(levels.shape, data, 16) | {254: ("I", (0,)), 262: ("H", (32803,))} | cells


def _image(shape: tuple[int, ...], data: bytes, bits: int) -> Directory:
    rows, cols = shape
    return {
        254: ("I", (1,)), 256: ("I", (cols,)), 257: ("I", (rows,)), 258: ("H", (bits,)),
        259: ("H", (1,)), 262: ("H", (1,)), 273: ("place", data), 277: ("H", (1,)),
        278: ("I", (rows,)), 279: ("I", (len(data),)),
    }  # fmt: skip


def _tiff(directory: Directory) -> bytes:
    return b"II*\0" + struct.pack("<I", 8) + _laid_out(directory, 8)


def _laid_out(directory: Directory, place: int) -> bytes:
    """A directory that begins at a place of the file, followed by everything that it points to."""
    behind = place + 2 + 12 * len(directory) + 4
    entries, body = b"", b""
    for tag, (kind, value) in sorted(directory.items()):
        if kind in ("place", "folder"):
            where = behind + len(body)
            body += value if kind == "place" else _laid_out(value, where)
            kind, value = "I", (where,)
        if kind in ("text", "bytes"):
            data, count = value, len(value)
        else:
            each = 2 if kind == "rational" else 1
            data = struct.pack(f"<{len(value)}{'I' if kind == 'rational' else kind}", *value)
            count = len(value) // each
        if len(data) > 4:
            where = behind + len(body)
            body += data + bytes(len(data) % 2)
            data = struct.pack("<I", where)
        entries += struct.pack("<HHI", tag, _CODES[kind], count) + data.ljust(4, b"\0")
    return struct.pack("<H", len(directory)) + entries + bytes(4) + body


def black_image(shape: tuple[int, int], blacks: tuple[int, ...]) -> NDArray[np.int64]:
    """The black level of each pixel; `blacks` are those of red, both greens, and blue."""
    return np.tile(np.array(blacks).reshape(2, 2), (shape[0] // 2, shape[1] // 2))
