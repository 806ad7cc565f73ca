"""The work folder that every case gets a copy of: small, good, and made by the command line."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from .run import run

SHAPE = (8, 8)
COUNT = 32
# The estimate that cases use: row by row, as it says what it holds most directly.
PLAIN = "estimate capture --no-coherent --no-check --tile-rows 16"
# One whose T is so dense that eight tiles are small beside the whole: a full disk then stops the
# run with all its tiles on disk.
TILED = (
    "estimate capture --no-coherent --no-check --solver admm --signed --regularization 1e-6 "
    "--iterations 3 --tile-rows 8"
)

# Slow enough to be caught at work: tiles of one row, each on disk before the next.
SLOWLY = "--no-coherent --no-check --solver admm --iterations 400 --tile-rows 1"

_COMMANDS = (
    f"patterns bernoulli -k {COUNT} --size 8x8 -o patterns",
    "simulate T.npz --patterns patterns --seed 1 -o capture",
    # Room light and leaking black, so that there is a black frame, and sixteen bits.
    "simulate T.npz --patterns patterns --bits 16 --leak 0.05 --ambient 0.3 -o lit",
    "estimate capture --no-check --correct none -o scene.zarr",
    f"{PLAIN} -o plain.zarr",
    f"{TILED} -o dense.zarr",
    f"estimate capture {SLOWLY} -o slow.zarr",
    "export plain.zarr plain.npz",
    # A T that is the identity, from one-pixel patterns that are their own photographs.
    "patterns onepixel --size 8x8 -o single",
    "estimate --patterns single --images single --no-background --regularization 1e-6 "
    "--no-coherent --no-check -o one.zarr",
)


def make_work(folder: Path) -> None:
    """Make the work folder.

    T.npz, patterns/, capture/, lit/ (with a black frame), scene.zarr, plain.zarr, plain.npz,
    dense.zarr, slow.zarr, one.zarr (the identity); photos/ and projected/ (frames and patterns as
    a user would have them), black.png, white.png, shown.png, holiday.jpg.
    """
    folder.mkdir(parents=True)
    write_truth(folder / "T.npz", matrix())
    for command in _COMMANDS:
        ran = run(command, folder)
        if ran.code != 0:
            raise RuntimeError(f"{command}: exit {ran.code}\n{ran.err}")
    shutil.copytree(folder / "capture" / "images", folder / "photos")
    shutil.copytree(folder / "capture" / "patterns", folder / "projected")
    (folder / "projected" / "patterns.json").unlink()
    shutil.copy(folder / "lit" / "black.png", folder / "black.png")
    shutil.copy(folder / "projected" / "pattern_0000.png", folder / "shown.png")
    shutil.copy(folder / "lit" / "images" / "image_0000.png", folder / "white.png")
    (folder / "holiday.jpg").write_bytes(b"a photograph that is dear to its owner")


@contextmanager
def fresh_copy(template: Path, names: Iterable[str]) -> Iterator[Path]:
    """A fresh copy of some things of the work folder, with room for temporary files beside it."""
    with tempfile.TemporaryDirectory(prefix="case-", dir=template.parents[2]) as base:
        (Path(base) / "tmp").mkdir()
        place = Path(base) / "outer" / "work"
        place.mkdir(parents=True)
        for name in names:
            source = template / name
            if source.is_dir():
                shutil.copytree(source, place / name, copy_function=shutil.copyfile)
            else:
                shutil.copyfile(source, place / name)
        yield place


def matrix(seed: int = 0) -> csr_array:
    """A T of 64 x 64: two strong entries a row, a few weak ones."""
    generator = np.random.default_rng(seed)
    dense = np.zeros((64, 64), np.float32)
    rows = np.arange(64)
    dense[rows, rows] = generator.uniform(0.05, 0.1, 64)
    dense[rows, (rows + 9) % 64] = generator.uniform(0.01, 0.04, 64)
    return csr_array(dense)


def write_truth(file: Path, truth: csr_array, **changed: object) -> None:
    """A truth file, with keys changed; None leaves one out."""
    content: dict[str, object] = {
        "format": np.array(b"csr"),
        "_is_array": np.array(True),
        "shape": np.array(truth.shape),
        "data": truth.data,
        "indices": truth.indices,
        "indptr": truth.indptr,
        "lightmatrix_truth": np.array(1),
        "camera_shape": np.array(SHAPE),
        "projector_shape": np.array(SHAPE),
        "direct_data": truth.data,
        "metadata": np.array(json.dumps({"scene": "made for tests"})),
        **changed,
    }
    kept = {name: np.asarray(value) for name, value in content.items() if value is not None}
    np.savez_compressed(file, **kept)  # type: ignore[arg-type]
