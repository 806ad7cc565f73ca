"""Messages that the page of the viewer would not send.

``python -m tests.viewer.hostile --count 10000`` sends mutated ones to a viewer.
"""

from __future__ import annotations

import argparse
import random
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil

import lightmatrix as lm
from lightmatrix.viewer.session import MessageKind
from tests.viewer import running

CAMERA, PROJECTOR = (24, 20), (16, 18)
LARGEST = 2**32 - 1


def messages(camera: tuple[int, int], projector: tuple[int, int]) -> list[bytes]:
    """Messages of the page, one of each kind."""
    return [
        struct.pack("<6I", MessageKind.PAINT, 1, 2, 3, 4, 5) + bytes(range(20)),
        struct.pack("<6I", MessageKind.PAINT, 1, 0, 0, *projector)
        + bytes(projector[0] * projector[1]),
        struct.pack("<4I", MessageKind.ROW, 2, camera[0] - 1, 3),
        struct.pack("<4I", MessageKind.COLUMN, 3, 4, projector[1] - 1),
    ]


def nonsense(camera: tuple[int, int], projector: tuple[int, int]) -> Iterator[object]:
    """What no page sends: sizes, places and lengths that do not fit."""
    rows, cols = projector
    yield from (None, "text", 5, b"", b"\0" * 7, b"\0" * 8, b"\xff" * 24)
    for kind, (height, width) in ((MessageKind.ROW, camera), (MessageKind.COLUMN, projector)):
        for row, col in ((height, 0), (0, width), (LARGEST, LARGEST)):
            yield struct.pack("<4I", kind, 1, row, col)
        yield struct.pack("<3I", kind, 1, 0)
        yield struct.pack("<5I", kind, 1, 0, 0, 0)
    for place in (
        (rows, 0, 1, 1),
        (0, cols, 1, 1),
        (0, 0, rows + 1, 1),
        (1, 0, LARGEST, 1),
        (0, 1, 1, LARGEST),
        (LARGEST, 1, 1, 1),
        (1, 1, 2**16, 2**16),
    ):
        size = min(place[2] * place[3], 1000)
        yield struct.pack("<6I", MessageKind.PAINT, 1, *place) + bytes(size)
    yield struct.pack("<6I", MessageKind.PAINT, 1, 0, 0, 2, 2) + bytes(3)
    yield struct.pack("<6I", MessageKind.PAINT, 1, 0, 0, 2, 2) + bytes(5)
    yield struct.pack("<2I", MessageKind.COMPENSATE, 1) + bytes(camera[0] * camera[1] - 1)
    yield struct.pack("<2I", 0, 1) + bytes(16)
    yield struct.pack("<2I", 99, 1) + bytes(16)


def mutated(generator: random.Random, whole: bytes) -> bytes:
    """A message with some bytes changed, cut off, or added."""
    message = bytearray(whole)
    for _ in range(generator.randint(1, 4)):
        place = generator.randrange(len(message) + 1)
        gone = generator.randint(0, 4)
        message[place : place + gone] = generator.randbytes(generator.choice((gone, 0, 1, 4)))
    return bytes(message)


def attack(server: running.Server, count: int, seed: int = 0) -> tuple[int, int, int]:
    """Send mutated messages; how many were answered and refused, and by how much memory grew."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
    from websockets.typing import Origin

    generator = random.Random(seed)
    process = psutil.Process(server.process.pid)
    whole = messages(CAMERA, PROJECTOR)
    address = f"ws://{server.host}/{server.token}/socket"
    origin = Origin(f"http://{server.host}")
    before = answered = refused = sent = 0
    while sent < count:
        with connect(address, proxy=None, origin=origin) as connection:
            while sent < count:
                if sent == count // 10:
                    before = process.memory_info().rss
                sent += 1
                try:
                    connection.send(mutated(generator, generator.choice(whole)))
                    connection.recv(timeout=120)
                    answered += 1
                except ConnectionClosed:
                    refused += 1
                    break
    return answered, refused, process.memory_info().rss - before


def main() -> None:
    """Send many mutated messages to a viewer, and print what became of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10_000)
    count = parser.parse_args().count
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "scene.zarr"
        lm.save(store, running.scene(CAMERA, PROJECTOR))
        with running.served(store, program=running.ON_DISK) as server:
            answered, refused, growth = attack(server, count)
    print(f"{answered} answered, {refused} refused; memory grew by {growth >> 10} KiB")


if __name__ == "__main__":
    main()
