"""Files that may not be read are not called damaged."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm


@pytest.fixture
def forbid(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a file unreadable, for root too, whom the system lets read anything."""
    usual = Path.open

    def forbidden(file: Path) -> None:
        def opened(path: Path, *arguments: Any, **more: Any) -> Any:
            if path == file:
                raise PermissionError(13, "Permission denied", str(path))
            return usual(path, *arguments, **more)

        access = os.access
        monkeypatch.setattr(os, "access", lambda path, mode: path != file and access(path, mode))
        monkeypatch.setattr(Path, "open", opened)

    return forbidden


def test_an_image_that_may_not_be_read(tmp_path: Path, forbid: Any) -> None:
    lm.write_image(tmp_path / "a.png", np.eye(4, dtype=np.uint8))
    forbid(tmp_path / "a.png")
    with pytest.raises(lm.InputError, match=r"a\.png: cannot be read \(Permission denied") as error:
        lm.read_image(tmp_path / "a.png")
    assert "permissions" in (error.value.hint or "")


@pytest.mark.parametrize("name", ["zarr.json", "data/zarr.json", "data/c/0"])
def test_a_store_that_may_not_be_read(tmp_path: Path, forbid: Any, name: str) -> None:
    lm.save(tmp_path / "s.zarr", lm.truth("metal").transport())
    forbid(tmp_path / "s.zarr" / name)
    with pytest.raises(lm.InputError, match="Permission denied") as error:
        lm.open(tmp_path / "s.zarr")
    assert name in error.value.message
    assert "permissions" in (error.value.hint or "")
    assert "damaged" not in error.value.message
