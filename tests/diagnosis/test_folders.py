"""`lightmatrix check` on folders, also on those that no estimate could open."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.cli import main


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.3)
    capture.save(tmp_path / "capture")
    return tmp_path / "capture"


def run(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[dict[str, object]]]:
    code = main(["check", *words.split(), "--json"])
    found = json.loads(capsys.readouterr().out)["findings"]
    assert all(set(each) == {"kind", "frames", "message", "advice"} for each in found)
    return code, found


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(folder), capsys) == (0, [])
    assert main(["check", str(folder)]) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    images = sorted((folder / "images").iterdir())
    images[3].write_bytes(images[4].read_bytes())
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("order", [3])]
    assert found == [each.as_dict() for each in lm.check(folder)]
    images[3].unlink()
    code, found = run(f"--patterns {folder}/patterns --images {folder}/images", capsys)
    assert code == 1
    assert [(each["kind"], each["frames"]) for each in found] == [("counts", [3])]
    assert "31 photographs" in str(found[0]["message"])
    assert main(["check", str(folder)]) == 1
    assert "counts: 32 patterns" in capsys.readouterr().out


def test_files_that_do_not_fit_together_are_findings(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = sorted((folder / "images").iterdir())
    for image in images[5:7]:
        lm.write_image(image, np.zeros((9, 9), np.uint8), overwrite=True)
    images[8].write_bytes(b"no image")
    code, found = run(str(folder), capsys)
    assert code == 1
    assert [each["kind"] for each in found] == ["files", "files"]
    assert [each["frames"] for each in found] == [[5, 6], [8]]
    assert str(found[0]["message"]).endswith(", and 1 more like it")
    assert "more like it" not in str(found[1]["message"])


def test_no_capture_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["nowhere"], ["--patterns", "p"], ["c", "--clip", "3"]):
        assert main(["check", *words]) == 2
        assert "error:" in capsys.readouterr().err
    with pytest.raises(lm.InputError):
        lm.check()


def test_estimate_says_what_check_finds(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for image in (folder / "images").iterdir():
        levels = lm.read_image(image) / 255
        bent = np.rint(255 * levels ** (1 / 2.2)).astype(np.uint8)
        lm.write_image(image, bent, overwrite=True)
    words = ["estimate", str(folder), "-o", str(tmp_path / "x.zarr"), "--no-coherent", "--json"]
    assert main([*words, "--iterations", "2"]) == 0
    shown = capsys.readouterr()
    assert "response: " in shown.err
    assert [each["kind"] for each in json.loads(shown.out)["findings"]] == ["response"]


def test_options_say_all_that_a_description_does(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two plain folders with options are the capture folder with its capture.json."""
    exposures = "0.4:0.5,0.1:0.5"
    simulated = lm.simulate(
        "metal", lm.BernoulliPatterns((64, 64), 32), exposure=exposures, black_level=5, ambient=0.1
    )
    simulated.save(tmp_path / "several")
    several = tmp_path / "several"
    listed = tmp_path / "exposures.txt"
    listed.write_text("\n".join(f"{e:.17g}" for e in simulated.exposures))
    words = f"--patterns {several}/patterns --images {several}/images --black {several}/black.png "
    words += f"--black-exposure 0.4 --black-level 5 --clip 255 --full-scale 255 --exposure {listed}"
    assert run(words, capsys) == (0, [])
    made: list[lm.LightTransport] = []
    for where in (words, str(several)):
        output = tmp_path / f"{len(made)}.zarr"
        command = f"estimate {where} -o {output} --no-coherent --iterations 2 --no-check"
        assert main(command.split()) == 0
        made.append(lm.open(output))
    np.testing.assert_array_equal(made[0].sparse.data, made[1].sparse.data)
    capsys.readouterr()
    given = ",".join(f"{e:g}" for e in simulated.exposures)
    assert run(words.replace(str(listed), given), capsys) == (0, [])
    for wrong in ("nonsense", "1,2,x", "1,2,3"):
        assert main(["check", *words.replace(str(listed), wrong).split()]) in (2,)
        assert wrong[:3] in capsys.readouterr().err or wrong == "1,2,3"
