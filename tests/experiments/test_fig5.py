"""The drawing of the scenes, and the numbers beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.errors import MissingExtraError
from lightmatrix.experiments import fig5
from lightmatrix.files.images import read_image
from lightmatrix.simulation import library
from lightmatrix.simulation.procedural_scene import ProceduralScene
from lightmatrix.simulation.scene_statistics import clipped_share, direct_share, entries_for_energy
from lightmatrix.simulation.truth import Truth


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    def photograph(name: str, shape: tuple[int, int], **_: Any) -> NDArray[np.float32]:
        return np.random.default_rng(0).random(shape, np.float32)

    out = tmp_path_factory.mktemp("fig5")
    steps: list[tuple[int, int]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fig5, "white_image", photograph)
        result = fig5.FIG5.run(out, quick=True, progress=lambda *step: steps.append(step))
    assert steps[-1][0] == steps[-1][1]
    return out, result


def test_without_the_renderer_the_bundled_matrices_are_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def photograph(*_: Any, **__: Any) -> NDArray[np.float32]:
        raise MissingExtraError("no renderer")

    monkeypatch.setattr(fig5, "white_image", photograph)
    image = fig5.measure(fig5.Case("gripper", 128)).arrays["photograph"]
    white = library.truth("gripper").matrix.sum(axis=1).reshape(64, 64)
    np.testing.assert_array_equal(image, white.astype(np.float32))


def test_all_figures_are_drawn(drawn: tuple[Path, dict[str, Any]]) -> None:
    out, result = drawn
    for name in ("fig1", "fig2", "fig5"):
        assert (out / f"{name}.svg").stat().st_size > 1000
        assert read_image(out / f"{name}.png").shape[1] > 1000
    assert json.loads((out / "fig5.json").read_text()) == json.loads(json.dumps(result))


def test_the_table_holds_the_statistics_of_the_scenes(
    drawn: tuple[Path, dict[str, Any]],
) -> None:
    rows = {row["scene"]: row for row in drawn[1]["rows"]}
    assert set(rows) == set(library.BUNDLED)
    for row in rows.values():
        assert row["entries_90"] <= row["entries_99"]
        assert row["clipped_share"] == sorted(row["clipped_share"])
    assert rows["corner"]["direct_share"] < rows["metal"]["direct_share"]
    assert rows["metal"]["direct_share"] < rows["gripper"]["direct_share"]
    # The corner clips by the sum of many small entries: far less than all of its light is direct.
    assert rows["corner"]["entries_90"] > 50 * rows["l_objects"]["entries_90"]
    assert rows["metal"]["diffuse_rows"] > 0.04


def test_statistics_of_a_matrix_known_by_hand() -> None:
    made = ProceduralScene((1, 3), (2, 2)).truth()
    dense = np.array([[8, 1, 0.5, 0.5], [1, 1, 1, 1], [0, 0, 0, 0]], np.float32)
    matrix = type(made.matrix)(dense)
    truth = Truth(matrix, matrix.data / 2, (1, 3), (2, 2))
    assert direct_share(truth) == pytest.approx(0.5)
    assert entries_for_energy(truth, 0.8).tolist() == [1, 4, 0]
    assert entries_for_energy(truth, 0.9).tolist() == [2, 4, 0]
    assert entries_for_energy(truth, 0.5).tolist() == [1, 2, 0]
    low, high = clipped_share(truth, (1e-6, 1e6), count=64)
    assert low == 0
    assert 0.5 < high < 2 / 3 + 1e-9
