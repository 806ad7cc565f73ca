"""Free memory: what the machine has, and what the control groups of a container leave of it."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest

from lightmatrix.errors import InputError
from lightmatrix.resources import memory
from lightmatrix.resources.memory import (
    available_bytes,
    bytes_left_by_groups,
    check_memory,
    memory_bytes,
)

MIB = 1 << 20


@pytest.fixture
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "mine")
    monkeypatch.setattr(memory, "_ALL_GROUPS", tmp_path / "mounted")
    return tmp_path


def second(place: Path, limit: str, used: int, cached: int = 0) -> None:
    place.mkdir(parents=True, exist_ok=True)
    (place / "memory.max").write_text(f"{limit}\n")
    (place / "memory.current").write_text(f"{used}\n")
    text = f"anon {used - cached}\nfile {cached}\ninactive_file {cached // 4}\n"
    (place / "memory.stat").write_text(f"{text}active_file {cached - cached // 4}\n")


def test_the_tightest_group_around_counts(groups: Path) -> None:
    (groups / "mine").write_text("0::/user.slice/job/step\n")
    top = groups / "mounted"
    # The root has no limit and no file for it.
    top.mkdir()
    assert bytes_left_by_groups() is None
    second(top / "user.slice" / "job" / "step", "max", 5 * MIB)
    assert bytes_left_by_groups() is None
    second(top / "user.slice" / "job", str(600 * MIB), 500 * MIB, cached=40 * MIB)
    second(top / "user.slice", str(4096 * MIB), 500 * MIB)
    assert bytes_left_by_groups() == 140 * MIB
    assert available_bytes() == min(140 * MIB, psutil.virtual_memory().available)
    second(top / "user.slice" / "job" / "step", str(90 * MIB), 91 * MIB)
    assert available_bytes() == 0


def test_groups_of_the_first_version(groups: Path) -> None:
    """In a container that sees its own group as the root, under another name."""
    (groups / "mine").write_text("5:cpu,cpuacct:/\n4:hugetlb,memory:/docker/0a1b\n0::/\n")
    place = groups / "mounted" / "memory"
    place.mkdir(parents=True)
    (place / "memory.limit_in_bytes").write_text(f"{300 * MIB}\n")
    (place / "memory.usage_in_bytes").write_text(f"{200 * MIB}\n")
    cached = f"total_inactive_file {30 * MIB}\ntotal_active_file {20 * MIB}\n"
    (place / "memory.stat").write_text(f"inactive_file 0\nactive_file 0\n{cached}")
    assert bytes_left_by_groups() == 150 * MIB
    # Version 1 writes this where there is no limit.
    (place / "memory.limit_in_bytes").write_text("9223372036854771712\n")
    free = psutil.virtual_memory().available
    assert available_bytes() == pytest.approx(free, rel=0.2)


def test_systems_without_groups(groups: Path) -> None:
    assert bytes_left_by_groups() is None
    assert available_bytes() > MIB


@pytest.mark.parametrize(
    ("text", "size"), [("4GiB", 4 << 30), ("800MB", 800 * 10**6), (" 2.5 tib ", 5 << 39)]
)
def test_amounts_of_memory(text: str, size: int) -> None:
    assert memory_bytes(text) == size


@pytest.mark.parametrize(
    "text", ["", "4", "4 G", "-1GiB", "GiB", "4GiB or so", "\u0664GiB", "9" * 400 + "GiB"]
)
def test_texts_that_are_no_amount_of_memory(text: str) -> None:
    with pytest.raises(InputError, match="an amount of memory"):
        memory_bytes(text)


def test_a_file_that_fits_no_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 1 << 30)
    check_memory(Path("T.npz"), 1 << 30)
    with pytest.raises(InputError, match=r"T\.npz: takes 2 GiB of memory, 1 GiB are free"):
        check_memory(Path("T.npz"), 2 << 30)
