"""D2 and D3: damaged images, and images that are bombs."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import tifffile

from ..case import Case, Limits, Prepare
from ..checks import every, within
from ..pictures import case, levels, plain_png, scanned, set_tag
from ..put import both, chunk, cut, endless_zeros, flip, png, text

GIB = 1 << 30


def _damaged() -> list[Case]:
    cases = []
    kinds = {"8": (8, 0, 1), "16": (16, 0, 1), "16 colour": (16, 2, 3)}
    for words, (depth, colour, channels) in kinds.items():
        data = len(png((8, 8), depth, colour, b""))
        put = plain_png("a.png", depth, colour, channels)
        for share in (0.35, 0.5, 0.65, 0.8):
            cases.append(
                case(
                    f"PNG of {words} bits, a bit flipped at {share}",
                    "a.png",
                    both(put, flip("a.png", share, 5)),
                )
            )
        cases.append(
            case(
                f"PNG of {words} bits cut off", "a.png", both(put, cut("a.png", data + 10)), code=2
            )
        )
    pixels = scanned(levels(8))
    sound = png((8, 8), 8, 0, pixels)
    two = sound[:33] + chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)) + sound[33:]
    bad_sum = bytearray(sound)
    bad_sum[-13] ^= 1
    more = {
        "with a wrong checksum": bytes(bad_sum),
        "with two headers": two,
        "without its end": sound[:-12],
        "with too few rows": png((8, 8), 8, 0, pixels[:36]),
        "with too many rows": png((8, 8), 8, 0, pixels * 2),
        "with an unknown filter": png((8, 8), 8, 0, b"\x09" + pixels[1:]),
        "of no pixels": png((0, 0), 8, 0, b""),
        "of 3 bits": png((8, 8), 3, 0, pixels),
        "of an unknown colour type": png((8, 8), 8, 5, pixels),
        "that claims 2^31 columns": png((8, 2**31 - 1), 8, 0, pixels),
        "of noise": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    }
    for words, data_bytes in more.items():
        strict = words not in ("without its end", "with too many rows", "with two headers")
        cases.append(
            case(f"PNG {words}", "a.png", text("a.png", data_bytes), code=2 if strict else (0, 2))
        )
    return cases


def _bombs() -> list[Case]:
    quick = within(15)
    room = Limits(memory=GIB)

    def bomb(shape: tuple[int, int], depth: int, colour: int, channels: int) -> Prepare:
        def fault(folder: Path) -> None:
            size = shape[0] * (1 + shape[1] * channels * depth // 8)
            sound = png(shape, depth, colour, b"")
            body = sound[:33] + chunk(b"IDAT", endless_zeros(size)) + chunk(b"IEND", b"")
            (folder / "a.png").write_bytes(body)

        return fault

    cases = []
    for words, parts in {
        "16-bit colour": ((26000, 26000), 16, 2, 3),
        "16-bit grey": ((46000, 46000), 16, 0, 1),
        "8-bit grey": ((64000, 64000), 8, 0, 1),
        "1-bit": ((180000, 180000), 1, 0, 1),
    }.items():
        put = bomb(*parts)
        cases += [
            Case(
                f"a bomb, PNG of {words}, relit",
                "relight scene.zarr a.png -o out.npy",
                "a.png|memory",
                put,
                code=(2, 3),
                limits=room,
                check=quick,
            ),
            Case(
                f"a bomb, PNG of {words}, as black frame",
                "estimate --patterns projected --images photos --black a.png -o new.zarr",
                "a.png|memory",
                put,
                code=(2, 3),
                limits=room,
                check=quick,
            ),
        ]

    def small_claim(folder: Path) -> None:
        # More data than the size says: what is too much must not be inflated.
        sound = png((8, 8), 16, 2, b"")
        body = sound[:33] + chunk(b"IDAT", endless_zeros(3 * GIB)) + chunk(b"IEND", b"")
        (folder / "a.png").write_bytes(body)

    def deflated(folder: Path) -> None:
        tifffile.imwrite(folder / "a.tif", np.zeros((8, 8), np.uint16), compression="zlib")
        for tag, value in (("ImageWidth", 65535), ("ImageLength", 65535), ("RowsPerStrip", 65535)):
            set_tag("a.tif", tag, value)(folder)

    cases += [
        Case(
            "a bomb, PNG of 8 x 8 with 3 GiB of data",
            "relight scene.zarr a.png -o out.npy",
            "a.png|memory",
            small_claim,
            code=(0, 2, 3),
            limits=room,
            check=quick,
        ),
        Case(
            "a bomb, TIFF",
            "relight scene.zarr a.tif -o out.npy",
            "a.tif|memory",
            deflated,
            code=(2, 3),
            limits=room,
            check=quick,
        ),
        Case(
            "a text chunk that is a bomb",
            "relight scene.zarr a.png -o out.npy",
            (),
            lambda folder: (folder / "a.png").write_bytes(
                png(
                    (8, 8),
                    8,
                    0,
                    scanned(levels(8)),
                    chunk(b"zTXt", b"a\0\0" + endless_zeros(2 * GIB)),
                    chunk(b"iCCP", b"a\0\0" + endless_zeros(2 * GIB)),
                )
            ),
            code=(0, 2, 3),
            limits=room,
            check=every(quick),
        ),
    ]
    return cases


# What its cases need of the work folder.
NEEDS = ("one.zarr", "scene.zarr", "photos", "projected")

CASES = [*_damaged(), *_bombs()]
