"""All experiments run and draw; a run continues after a stop."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from skimage.metrics import structural_similarity

from experiments import fig7
from experiments.__main__ import EXPERIMENTS, main
from experiments.harness import Experiment, Measured, means


@dataclass(frozen=True)
class Number:
    value: int

    @property
    def name(self) -> str:
        return f"n{self.value}"


def test_a_stopped_run_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured: list[int] = []

    def measure(case: Number) -> Measured:
        measured.append(case.value)
        if len(measured) == 2:
            raise KeyboardInterrupt
        return Measured([{"group": "all", "error": case.value / 4}], {"image": np.eye(2)})

    def draw(out: Path, results: list[tuple[Number, Measured]]) -> None:
        assert all((each.arrays["image"] == np.eye(2)).all() for _, each in results)
        (out / "fig4.png").touch()

    experiment = Experiment(
        "fig4",
        lambda quick: [Number(1), Number(2), Number(3)],
        measure,
        draw,
        lambda quick: {"quick": quick},
        lambda rows: means(rows, ("group",), ("error",)),
    )
    monkeypatch.setitem(EXPERIMENTS, "fig4", experiment)
    command = ["fig4", "--quick", "-o", str(tmp_path / "out")]
    assert main(command) == 130
    damaged = tmp_path / "out" / "cases" / "n1.npz"
    damaged.write_bytes(damaged.read_bytes()[:50])
    assert main(command) == 0
    assert measured == [1, 2, 1, 2, 3]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"fig4.json", "fig4.csv", "fig4.png"}
    mean = {"group": "all", "seeds": 3, "error": 0.5}
    content = json.loads((tmp_path / "out" / "fig4.json").read_text())
    assert (content["parameters"], content["means"]) == ({"quick": True}, [mean])
    with (tmp_path / "out" / "fig4.csv").open() as opened:
        assert list(csv.DictReader(opened)) == [{"group": "all", "seeds": "3", "error": "0.5"}]
    assert main(command) == 2
    assert "exists" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_cases_have_names_of_their_own(name: str) -> None:
    for quick in (True, False):
        names = [case.name for case in EXPERIMENTS[name].cases(quick)]
        assert len(set(names)) == len(names) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_all_experiments_run_and_draw(name: str, tmp_path: Path) -> None:
    assert main([name, "--quick", "-o", str(tmp_path)]) == 0
    content = json.loads((tmp_path / f"{name}.json").read_text())
    with (tmp_path / f"{name}.csv").open() as opened:
        assert len(list(csv.DictReader(opened))) == len(content.get("means", content["rows"]))
    # The quick run of few patterns has no curves.
    assert name == "few-patterns" or (tmp_path / f"{name}.png").stat().st_size > 1000


@pytest.mark.parametrize("noise", [0.01, 0.5])
def test_the_structural_similarity_is_that_of_scikit_image(noise: float) -> None:
    random = np.random.default_rng(0)
    expected = ndimage.gaussian_filter(random.random((40, 30)), 2)
    expected[5:9, 6:20] += 0.5
    image = np.maximum(expected + noise * random.standard_normal(expected.shape), 0)
    displayed = [np.clip(part / np.quantile(expected, 0.99), 0, 1) for part in (image, expected)]
    # The mean of the whole map, margins too, which scikit-image leaves out.
    _, similarity = structural_similarity(  # type: ignore[no-untyped-call]
        *displayed, win_size=7, data_range=1, use_sample_covariance=False, full=True
    )
    assert fig7.quality(image, expected)["ssim"] == pytest.approx(similarity.mean(), rel=1e-9)
