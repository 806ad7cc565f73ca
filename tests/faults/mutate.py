"""Ways to damage a file: by its bytes, or by what it means."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Generator = np.random.Generator
# A damage says in words what it did.
Damage = Callable[[Generator, Path], str]


# ---- bytes


def flip_bit(draw: Generator, file: Path) -> str:
    """One bit turned round."""
    data = bytearray(file.read_bytes())
    at, bit = int(draw.integers(max(1, len(data)))), int(draw.integers(8))
    if data:
        data[at] ^= 1 << bit
    file.write_bytes(bytes(data))
    return f"bit {bit} of byte {at} flipped"


def cut(draw: Generator, file: Path) -> str:
    """The end is lost."""
    data = file.read_bytes()
    size = int(draw.integers(len(data) + 1))
    file.write_bytes(data[:size])
    return f"cut to {size} of {len(data)} bytes"


def insert(draw: Generator, file: Path) -> str:
    """A few bytes too many."""
    data = file.read_bytes()
    at, count = int(draw.integers(len(data) + 1)), int(draw.integers(1, 9))
    file.write_bytes(data[:at] + draw.bytes(count) + data[at:])
    return f"{count} bytes inserted at {at}"


def blank(draw: Generator, file: Path) -> str:
    """A stretch of zeros, as a bad sector leaves."""
    data = bytearray(file.read_bytes())
    at, size = int(draw.integers(max(1, len(data)))), int(draw.integers(1, 64))
    data[at : at + size] = bytes(len(data[at : at + size]))
    file.write_bytes(bytes(data))
    return f"{size} bytes at {at} are 0"


# ---- files


def lose(draw: Generator, file: Path) -> str:
    """The file is gone."""
    file.unlink()
    return "lost"


def replace(draw: Generator, file: Path) -> str:
    """Another thing than a file."""
    file.unlink()
    kind = int(draw.integers(3))
    if kind == 0:
        file.mkdir()
    elif kind == 1:
        os.mkfifo(file)
    else:
        file.symlink_to(("nowhere", file.name)[int(draw.integers(2))])
    return f"now a {('folder', 'pipe', 'link')[kind]}"


BYTES: tuple[Damage, ...] = (flip_bit, flip_bit, cut, insert, blank)
FILES: tuple[Damage, ...] = (lose, replace)


# ---- JSON

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 0.5, 1e300, -1e300, 2**31, 2**63, 2**64, 10**30),
    *(float("nan"), float("inf"), "", "text", "[/red]", ":x:", "2", "../x.png", "\0", "é" * 50),
    *([], {}, [1], [0, 0], [8, 8], [-8, 8], [2**40, 2**40], [[8], [8]], {"a": 1}, [None], ["8", 8]),
)


def change_json(draw: Generator, file: Path) -> str:
    """One value, somewhere, becomes another; or a key is renamed, lost or added."""
    content = json.loads(file.read_text())
    places = list(_places(content))
    holder, key = places[int(draw.integers(len(places)))]
    how = int(draw.integers(8))
    if how < 5:
        value = ODD[int(draw.integers(len(ODD)))]
        words = f"{key} = {str(value)[:30]}"
        holder[key] = value
    elif how == 5 and isinstance(holder, dict):
        holder[f"{key}s"] = holder.pop(key)
        words = f"{key} renamed"
    elif how == 6 and isinstance(holder, dict):
        del holder[key]
        words = f"{key} lost"
    else:
        other, place = places[int(draw.integers(len(places)))]
        holder[key] = json.loads(json.dumps(other[place]))
        words = f"{key} as {place}"
    file.write_text(json.dumps(content))
    return words


def _places(content: Any) -> Any:
    items = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in list(items):
        yield content, key
        if isinstance(value, (dict, list)):
            yield from _places(value)
