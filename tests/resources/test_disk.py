"""Disk space is checked before outputs are written, and reserved for temporary arrays."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from lightmatrix.errors import LightMatrixError, OutputError
from lightmatrix.resources import memory
from tests.helpers.limits import largest_file
from tests.helpers.systems import LIMITS


@LIMITS
def test_large_arrays_reserve_their_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kind = np.dtype(np.uint16)
    monkeypatch.setattr(memory, "SCRATCH_MEMORY_BYTES", 100)
    assert not isinstance(memory.scratch_array((5, 10), kind), np.memmap)
    mapped = memory.scratch_array((5, 11), kind)
    assert isinstance(mapped, np.memmap)
    mapped[...] = 7
    assert mapped.shape == (5, 11)
    assert mapped.sum() == 7 * 55
    with pytest.raises(OutputError, match=r"no space for 2,097,152 TiB"):
        memory.scratch_array((1 << 30, 1 << 30), kind)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 1 << 62))
    with largest_file(4096), pytest.raises(LightMatrixError, match="no space for") as error:
        memory.scratch_array((100, 100), kind)
    assert "TMPDIR" in str(error.value)


def test_an_output_larger_than_the_disk_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def usage(place: Path) -> object:
        asked.append(place)
        return shutil._ntuple_diskusage(1 << 32, 1 << 31, 1 << 31)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    folder = tmp_path / "new" / "folder"
    memory.check_disk_space(folder, 1 << 31, "out.zarr")
    with pytest.raises(OutputError, match=r"out\.zarr: takes at least 4 GiB, 2 GiB are free"):
        memory.check_disk_space(folder, 1 << 32, "out.zarr", "at least")
    assert asked == [tmp_path, tmp_path]


def test_disks_that_do_not_say_how_much_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(_: object) -> None:
        raise OSError("unknown")

    monkeypatch.setattr(shutil, "disk_usage", unknown)
    memory.check_disk_space(tmp_path, 1 << 60, "out.zarr")
