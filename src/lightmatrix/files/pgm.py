"""Grey images in the binary portable graymap format (P5), as machine vision cameras write them.

Levels stay as they are stored. A file of 12 bits says so by its largest level, 4095; other readers
stretch it to 65535.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.reading import check_image_size

# A number of the header, after white space and comments.
_NUMBER = re.compile(rb"(?:\s+|#[^\n\r]*[\n\r])+(\d{1,9})")
# Bytes in which the next number of a header must end, comments included.
_MOST_HEADER = 1 << 16


def read_pgm(file: Path) -> NDArray[Any]:
    """The image of a PGM file, (rows, cols) uint8 or uint16; a ValueError says what is damaged."""
    data = file.read_bytes()
    if not data.startswith(b"P5"):
        raise ValueError("not a binary PGM file")
    numbers, place = [], 2
    for _ in range(3):
        match = _NUMBER.match(data, place, place + _MOST_HEADER)
        if match is None:
            raise ValueError("a header without width, height and largest level")
        numbers.append(int(match[1]))
        place = match.end()
    cols, rows, top = numbers
    check_image_size(file, (rows, cols))
    if not 1 <= top <= 65535:
        raise ValueError(f"a largest level of {top}")
    if top < 255:
        raise ValueError(f"its white is {top}, not 255")
    kind = np.dtype(np.uint8 if top < 256 else ">u2")
    # One white space stands between the header and the levels.
    content = data[place + 1 :]
    if not data[place : place + 1].isspace() or len(content) != rows * cols * kind.itemsize:
        raise ValueError("more or fewer levels than its header says")
    image = np.frombuffer(content, kind).reshape(rows, cols)
    if int(image.max()) > top:
        raise ValueError(f"a level above its largest one, {top}")
    return image.astype(kind.newbyteorder("="))
