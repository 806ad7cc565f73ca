"""Finding LLVM: tried in a child process, with a way on where there is none."""

from __future__ import annotations

import importlib.util
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lightmatrix.errors import MissingExtraError
from lightmatrix.simulation import renderer as llvm

needs_renderer = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="needs the extra `render`"
)


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    find = llvm.usable_llvm
    find.cache_clear()
    yield
    find.cache_clear()


class Children:
    """Stands in for child processes: those whose library is in `good` succeed."""

    def __init__(self, good: set[str]) -> None:
        self.good = good
        self.tried: list[str] = []

    def run(self, command: list[str], *, env: dict[str, str], **_: Any) -> Any:
        library = env.get("DRJIT_LIBLLVM_PATH", "")
        self.tried.append(library)
        code = 0 if library in self.good else -6  # as libLLVM 15 and 16 do: abort
        return subprocess.CompletedProcess(command, code)


def test_new_libraries_are_tried_first_and_old_ones_never(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (
        "libLLVM-14.so.1",
        "libLLVM-16.so",
        "libLLVM-17.so.1",
        "libLLVM.so.19.1",
        "libX.so",
    ):
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "_FOLDERS", (str(tmp_path),))
    children = Children({str(tmp_path / "libLLVM-17.so.1")})
    monkeypatch.setattr(subprocess, "run", children.run)
    assert llvm.usable_llvm() == str(tmp_path / "libLLVM-17.so.1")
    assert children.tried == [str(tmp_path / "libLLVM.so.19.1"), str(tmp_path / "libLLVM-17.so.1")]


def test_the_users_own_choice_is_the_only_one_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/somewhere/libLLVM.so")
    children = Children(set())
    monkeypatch.setattr(subprocess, "run", children.run)
    assert llvm.usable_llvm() is None
    assert children.tried == ["/somewhere/libLLVM.so"]


def test_a_hanging_child_counts_as_unusable(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(command: list[str], **_: Any) -> Any:
        raise subprocess.TimeoutExpired(command, 120)

    monkeypatch.setattr(subprocess, "run", hang)
    monkeypatch.setattr(llvm, "_FOLDERS", ())
    assert llvm.usable_llvm() is None


@needs_renderer
def test_without_llvm_its_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm, "usable_llvm", lambda: None)
    with pytest.raises(MissingExtraError, match="needs LLVM") as caught:
        llvm.load_mitsuba()
    assert "apt-get install libllvm19" in str(caught.value.hint)
