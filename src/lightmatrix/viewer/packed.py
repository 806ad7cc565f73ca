"""The format in which numbers travel to the page: a header in JSON, then plain arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

# The first bytes. The number is the version of the format.
_MAGIC = b"LMVIEW1\n"
# Arrays begin at multiples of this many bytes, as typed arrays of a browser require.
_ALIGNMENT = 8
_DTYPES = {"u1": np.uint8, "u2": np.uint16, "u4": np.uint32, "f2": np.float16, "f4": np.float32}


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A header and arrays as bytes.

    They are: eight letters, the length of the JSON (4 bytes, little endian), the JSON, and the
    arrays. The JSON's ``arrays`` holds the type, the number of values and the offset of each array,
    counted from the end of the JSON.
    """
    places: dict[str, dict[str, Any]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, values in arrays.items():
        kind = f"{values.dtype.kind}{values.dtype.itemsize}"
        raw = np.ascontiguousarray(values, _DTYPES[kind]).astype(f"<{kind}", copy=False).tobytes()
        places[name] = {"type": kind, "count": int(values.size), "offset": offset}
        padding = -len(raw) % _ALIGNMENT
        parts += [raw, bytes(padding)]
        offset += len(raw) + padding
    text = json.dumps({**header, "arrays": places}, allow_nan=False).encode()
    start = len(_MAGIC) + 4
    text += b" " * (-(start + len(text)) % _ALIGNMENT)
    return b"".join([_MAGIC, len(text).to_bytes(4, "little"), text, *parts])
