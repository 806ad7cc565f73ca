"""Freed arrays are used again, so that the system does not clear their pages each time."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Fills three arrays of 20 MB three times, and prints how many new pages that took after the first.
FILL = """
import resource
{first}
import numpy as np
def fill():
    return [np.ones(20 << 20, np.uint8) for _ in range(3)]
def pages():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
fill()
before = pages()
for _ in range(3):
    fill()
print(pages() - before)
"""
KEEP = "from lightmatrix.cli import keep_freed_memory; keep_freed_memory()"


def new_pages(first: str) -> int:
    code = FILL.format(first=first)
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return int(ran.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="the allocator of Linux")
def test_freed_arrays_take_no_new_pages() -> None:
    usual = new_pages("")
    if usual < 1000:
        pytest.skip("this C library keeps freed memory by itself")
    assert new_pages(KEEP) < usual / 10
