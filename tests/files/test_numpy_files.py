"""npy and npz files: what threads read side by side."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lightmatrix.files.numpy_files import map_npy, read_npz


@pytest.fixture
def collector_that_yields() -> Iterator[None]:
    """A garbage collector that calls Python code, as that of dask does, and often."""

    def pause(*_: Any) -> None:
        time.sleep(0)

    threshold, interval = gc.get_threshold(), sys.getswitchinterval()
    gc.callbacks.append(pause)
    gc.set_threshold(10)
    sys.setswitchinterval(1e-6)
    yield
    gc.callbacks.remove(pause)
    gc.set_threshold(*threshold)
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("collector_that_yields")
def test_threads_read_side_by_side(tmp_path: Path) -> None:
    """Python up to 3.11.7 cannot parse two headers at once: of 150 files, 46 were "damaged"."""
    values = np.arange(4)
    np.savez(tmp_path / "a.npz", *[values] * 20)
    np.save(tmp_path / "a.npy", values)
    with ThreadPoolExecutor(4) as pool:
        read = [pool.submit(read_npz, tmp_path / "a.npz") for _ in range(100)]
        mapped = [pool.submit(map_npy, tmp_path / "a.npy") for _ in range(100)]
        assert all(len(each.result()) == 20 for each in read)
        assert all((each.result() == values).all() for each in mapped)
