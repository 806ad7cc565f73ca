"""A limit of the address space below what the libraries need ends in one message."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lightmatrix.cli import LEAST_ADDRESS_SPACE
from lightmatrix.cli.app import report

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")


@pytest.mark.parametrize("mebibytes", [130, 150, 180, 300])
def test_too_little_address_space_is_said_at_once(mebibytes: int) -> None:
    line = f"ulimit -v {mebibytes << 10}; exec {sys.executable} -m lightmatrix info none.zarr"
    ran = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=120)
    assert (ran.returncode, ran.stdout) == (3, "")
    assert f"error: not enough memory: {mebibytes} MiB of address space are allowed" in ran.stderr
    assert f"{LEAST_ADDRESS_SPACE >> 20} MiB are the least" in ran.stderr
    assert len(ran.stderr.splitlines()) == 2


def test_a_library_that_finds_no_room_is_a_lack_of_memory() -> None:
    words = "libscipy_openblas.so: failed to map segment from shared object"
    assert report(ImportError(words)) == 3
    assert report(ImportError("No module named 'scipy'")) == 70
