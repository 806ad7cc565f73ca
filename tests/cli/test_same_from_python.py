"""Each command and its Python function give the same result, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.cli import estimate as estimate_command
from lightmatrix.cli import main
from lightmatrix.cli import patterns as patterns_command
from lightmatrix.cli.app import STAGES
from lightmatrix.estimators import settings as estimate_settings
from lightmatrix.judgement.judgement import verdicts
from lightmatrix.patterns import making
from lightmatrix.planning.plan import Advice
from lightmatrix.rig.rig_measurements import PARTS
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import binned


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A truth, patterns, a capture and an estimate, made by commands."""
    folder = tmp_path_factory.mktemp("work")
    ProceduralScene((12, 11), (8, 8), background=0).truth().save(folder / "T.npz")
    for line in (
        "patterns bernoulli -k 48 --size 8x8 -o {}/patterns",
        "simulate {}/T.npz --patterns {}/patterns --exposure 1.2 -o {}/capture",
        "estimate {}/capture -o {}/scene.zarr",
    ):
        assert main(line.replace("{}", str(folder)).split()) == 0
    return folder


def _run(line: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main([*line.split(), "--json"]) == 0
    printed: dict[str, Any] = json.loads(capsys.readouterr().out)
    return printed


def _same_matrix(one: csr_array, other: csr_array) -> None:
    for name in ("indptr", "indices", "data"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def _same_transport(one: lm.LightTransport, other: lm.LightTransport) -> None:
    _same_matrix(one.sparse, other.sparse)
    np.testing.assert_array_equal(one.background, other.background)
    assert one.background_grid == other.background_grid
    assert set(one.diagnostics) == set(other.diagnostics)
    for name, values in one.diagnostics.items():
        np.testing.assert_array_equal(values, other.diagnostics[name])


def _same_files(one: Path, other: Path) -> None:
    """Whether two folders hold the same files, but for the times within archives."""
    names = sorted(str(path.relative_to(one)) for path in one.rglob("*") if path.is_file())
    assert names
    assert names == sorted(str(p.relative_to(other)) for p in other.rglob("*") if p.is_file())
    for name in names:
        if name.endswith(".npz"):
            with np.load(one / name) as a, np.load(other / name) as b:
                assert set(a.files) == set(b.files)
                for key in a.files:
                    np.testing.assert_array_equal(a[key], b[key])
        else:
            assert (one / name).read_bytes() == (other / name).read_bytes(), name


@pytest.mark.parametrize("kind", making.KINDS)
def test_patterns(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Gray code has as many patterns as it needs, with and without sinusoids.
    count = None if kind in ("graycode", "phase") else 12
    words = "" if count is None else f"-k {count} "
    line = f"patterns {kind} {words}--size 16x8 --block 4x2 --seed 3 -o {tmp_path}/shown"
    printed = _run(line, capsys)
    made = lm.make_patterns(kind, (16, 8), count, block=(4, 2), seed=3)
    lm.write_patterns(tmp_path / "written", made)
    _same_files(tmp_path / "shown", tmp_path / "written")
    assert printed["digest"] == made.digest


def test_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    listed = _run("scenes", capsys)["scenes"]
    assert [tuple(scene.values()) for scene in listed] == [tuple(scene) for scene in lm.scenes()]


def test_render(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mitsuba")
    _run(f"render wall --size 8x9 --spp 16 --seed 2 -o {tmp_path}/T.npz", capsys)
    read, made = lm.truth(f"{tmp_path}/T.npz"), lm.render("wall", (8, 9), samples=16, seed=2)
    _same_matrix(read.matrix, made.matrix)
    np.testing.assert_array_equal(read.direct_data, made.direct_data)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("--exposure 1.2", {"exposure": 1.2}),
        ("--exposure 1:0.75,0.25:0.25 --bits 12", {"exposure": "1:0.75,0.25:0.25", "bits": 12}),
        (
            "--leak 0.02 --ambient 0.1 --black-level 4 --blur 0.7 --vignetting 0.3 "
            "--shot-noise 0.01 --noise 0.01 --seed 5",
            {
                "leak": 0.02, "ambient": 0.1, "black_level": 4, "blur": 0.7, "vignetting": 0.3,
                "shot_noise": 0.01, "noise": 0.01, "seed": 5,
            },
        ),
    ],
)  # fmt: skip
def test_simulate(
    words: str, settings: dict[str, Any], work: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    line = f"simulate {work}/T.npz --patterns {work}/patterns {words} -o {tmp_path}/shown"
    printed = _run(line, capsys)
    capture = lm.simulate(f"{work}/T.npz", lm.read_patterns(work / "patterns"), **settings)
    capture.save(tmp_path / "saved")
    _same_files(tmp_path / "shown", tmp_path / "saved")
    # The capture in memory equals the one that is read back, so that an estimate needs no folder.
    read = lm.Capture.open(tmp_path / "shown")
    assert read.digest == capture.digest
    assert read.description == capture.description
    assert printed["frames"] == 48
    assert sum(printed["exposures"].values()) == 48
    known = lm.truth(str(tmp_path / "shown" / "truth.npz"))
    _same_matrix(known.matrix, capture.truth.matrix)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("", {}),
        ("--no-coherent", {"coherent": False}),
        ("--solver romp --fidelity linear", {"solver": "romp", "fidelity": "linear"}),
        (
            "--solver saturation-admm --fidelity clipped --iterations 30 --signed --tile-rows 50",
            {
                "solver": "saturation-admm", "fidelity": "clipped", "iterations": 30,
                "signed": True, "tile_rows": 50,
            },
        ),
        ("--solver admm --iterations 30", {"solver": "admm", "iterations": 30}),
        ("--multi-scale --no-background", {"multi_scale": True, "background": False}),
        ("--regularization 0.07 --coherent", {"regularization": 0.07, "coherent": True}),
    ],
)  # fmt: skip
def test_estimate(
    words: str, settings: dict[str, Any], work: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    # The checks, which take longest, with the first settings only.
    unchecked = "--no-check" if words else ""
    printed = _run(f"estimate {work}/capture {words} {unchecked} -o {tmp_path}/shown.zarr", capsys)
    made = lm.estimate(
        work / "capture", output=tmp_path / "made.zarr", check=not unchecked, **settings
    )
    shown = lm.open(tmp_path / "shown.zarr")
    _same_transport(shown, made)
    _same_transport(shown, lm.open(tmp_path / "made.zarr"))
    assert shown.provenance == lm.open(tmp_path / "made.zarr").provenance
    summary = shown.summary()
    assert {name: printed[name] for name in summary} == summary


def test_estimate_from_two_binned_folders(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = work / "capture" / "images"
    bins = "--bin-camera 2 --bin-projector 2x1 --clip 250"
    line = f"estimate --patterns {work}/patterns --images {images} {bins} -o {tmp_path}/shown.zarr"
    _run(f"{line} --no-check", capsys)
    capture = lm.Capture.from_folders(
        work / "patterns", images, lm.ReadSettings(clip=250), bin_camera=2, bin_projector=(2, 1)
    )
    _same_transport(lm.open(tmp_path / "shown.zarr"), lm.estimate(capture, check=False))


def test_info(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = _run(f"info {work}/scene.zarr", capsys)
    transport = lm.open(work / "scene.zarr")
    judged = verdicts(transport).transport
    assert printed == {
        "verdict": judged.level, "sentence": judged.sentence,
        "verdicts": lm.verdicts(transport).as_dict(),
        **transport.summary(), "provenance": transport.provenance,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "view", "index"),
    [
        ("row 3,4 -o x.png", "row", (3, 4)),
        ("dual -o x.tiff", "dual", ()),
        ("correspondence -o x.npz", "correspondence", ()),
        ("depth --geometry ../rig.json -o x.npy", "depth", ()),
    ],
)
def test_show(
    words: str, view: str, index: tuple[int, ...], work: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    for folder in ("shown", "made"):
        (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path / "shown")
    camera = np.array([[10.0, 0, 5, 0], [0, 10, 5, 0], [0, 0, 1, 0]])
    projector = np.array([[10.0, 0, 4, 5], [0, 10, 4, 0], [0, 0, 1, 0]])
    rig = lm.RigGeometry(camera, projector, (12, 11), (8, 8))
    rig.save("../rig.json")
    printed = _run(f"show {work}/scene.zarr {words}", capsys)
    assert printed == {"output": words.split()[-1], "view": view}
    made = tmp_path / "made" / words.split()[-1]
    geometry = rig if "--geometry" in words else None
    lm.show(work / "scene.zarr", view, *index, geometry=geometry, output=made)
    _same_files(tmp_path / "shown", tmp_path / "made")


@pytest.mark.parametrize("name", ["out.PNG", "out.npy", "out.exr"])
def test_relight(name: str, work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if name.endswith("exr"):
        pytest.importorskip("OpenEXR")
    pattern = work / "patterns" / "pattern_0003.png"
    gamma = 2.2 if name.lower().endswith("png") else 1.0
    (tmp_path / "shown").mkdir()
    line = f"relight {work}/scene.zarr {pattern} --exposure 0.7 --gamma {gamma}"
    printed = _run(f"{line} -o {tmp_path}/shown/{name}", capsys)
    output = tmp_path / "made" / name
    image = lm.relight(work / "scene.zarr", pattern, exposure=0.7, gamma=gamma, output=output)
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert printed["mean"] == float(image.mean())
    written = lm.read_image(output)
    if gamma == 2.2:
        expected = np.rint(255 * np.clip(image, 0, 1) ** (1 / 2.2))
        np.testing.assert_allclose(written, expected, atol=1)
    else:
        np.testing.assert_array_equal(written, image)


def _wanted(work: Path) -> Path:
    """A picture of the camera's size."""
    picture = work / "wanted.png"
    if not picture.exists():
        rows, cols = lm.open(work / "scene.zarr").camera_shape
        ramp = np.rint(np.tile(np.linspace(60, 255, cols), (rows, 1))).astype(np.uint8)
        lm.write_image(picture, ramp)
    return picture


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("-o x.png", {}),
        ("-o x.npy --brightness 0.4 --gamma 2.2", {"brightness": 0.4, "gamma": 2.2}),
        ("-o x.tiff --mask {wanted} --black {black}", {"mask": "{wanted}", "ambient": "{black}"}),
    ],
)
def test_compensate(
    words: str, settings: dict[str, Any], work: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    wanted = _wanted(work)
    black = tmp_path / "black.png"
    lm.write_image(black, np.full(lm.open(work / "scene.zarr").camera_shape, 3, np.uint8))
    names = {"wanted": wanted, "black": black}
    for folder in ("shown", "made"):
        (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path / "shown")
    told = _run(f"compensate {work}/scene.zarr {wanted} {words.format(**names)}", capsys)
    settings = {k: v.format(**names) if isinstance(v, str) else v for k, v in settings.items()}
    output = tmp_path / "made" / words.split()[1]
    found = lm.compensate(work / "scene.zarr", wanted, output=output, **settings)
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert told == {"output": output.name, **found.as_dict()}


def test_compensate_with_two_projectors(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, wanted = work / "scene.zarr", _wanted(work)
    for folder in ("shown", "made"):
        (tmp_path / folder).mkdir()
    _run(f"compensate {scene} {wanted} --beside {scene} -o {tmp_path}/shown/x.png", capsys)
    lm.compensate([scene, scene], wanted, output=tmp_path / "made" / "x.png")
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert (tmp_path / "made" / "x-2.png").exists()


def test_compensate_a_video(work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, frames = work / "scene.zarr", tmp_path / "frames"
    frames.mkdir()
    picture = lm.read_image(_wanted(work))
    for k in range(3):
        lm.write_image(frames / f"{k}.png", np.roll(picture, k, axis=1))
    told = _run(f"compensate {scene} {frames} -o {tmp_path}/shown", capsys)
    video = lm.compensate_video(scene, frames, output=tmp_path / "made")
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert told == {"output": f"{tmp_path}/shown", **video.as_dict()}


def test_compensate_cancels_global_light(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.zarr"
    lm.save(scene, binned(lm.truth("l_objects"), 4).transport())
    for folder in ("shown", "made"):
        (tmp_path / folder).mkdir()
    told = _run(f"compensate {scene} --cancel-global -o {tmp_path}/shown/x.png", capsys)
    found = lm.cancel_global(scene, output=tmp_path / "made" / "x.png")
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert told == {"output": f"{tmp_path}/shown/x.png", **found.as_dict()}


def test_compensate_on_a_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    rig = "virtual:procedural,size=16,real=0"
    known = lm.ProceduralScene((16, 16), (16, 16), 0).truth().transport()
    lm.save(tmp_path / "scene.zarr", known)
    lm.write_image(tmp_path / "wanted.png", np.full((16, 16), 150, np.uint8))
    for folder in ("shown", "made"):
        (tmp_path / folder).mkdir()
    told = _run(
        f"compensate {tmp_path}/scene.zarr {tmp_path}/wanted.png --rig {rig} --refine 2 "
        f"--settle 0.2 --rig-file {tmp_path}/rig.json -o {tmp_path}/shown/x.png",
        capsys,
    )
    with lm.open_rig(rig) as opened:
        found = lm.refine_compensation(
            opened,
            known,
            tmp_path / "wanted.png",
            steps=2,
            settle=0.2,
            output=tmp_path / "made" / "x.png",
        )
    kept = lm.RigMeasurements.load(tmp_path / "rig.json").settle
    assert kept is not None
    assert kept.seconds == 0.2
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert told["photographed_psnr"] == found.as_dict()["photographed_psnr"]
    assert len(told["photographed_psnr"]) == 3


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("", "no picture"),
        ("{wanted} --live", "--live for a compensation without"),
        ("{wanted} --rig virtual:metal --projector-response linear", "--projector-response for"),
        (". --rig virtual:metal", "a video for a rig"),
        ("{wanted} --brightness 70", "give a share of the light of white, such as 0.7 for 70 %"),
        ("{wanted} --refine 2", "--refine for a compensation without"),
        ("{wanted} --settle 1", "--settle for a compensation without"),
        ("{wanted} --rig virtual:metal --black b.png", "--black for a rig"),
        ("{wanted} --rig virtual:metal --beside x.zarr", "--beside for a"),
        (". --beside x.zarr", "--beside for a"),
        ("{wanted} --brightness bright", "Invalid value for '--brightness'"),
        ("--cancel-global --rig virtual:metal", "a rig for --cancel-global"),
        ("--cancel-global --brightness 0.7", "--brightness for --cancel-global"),
    ],
)
def test_what_compensate_refuses(
    words: str, reason: str, work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"compensate {work}/scene.zarr {words} -o {tmp_path}/new.png"
    assert main(line.format(wanted=_wanted(work)).split()) == 2
    assert reason in capsys.readouterr().err


def test_evaluate(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = _run(f"evaluate {work}/scene.zarr --truth {work}/T.npz --exposure 1.2", capsys)
    estimate, known = lm.open(work / "scene.zarr"), lm.truth(f"{work}/T.npz")
    assert printed == lm.evaluate(estimate, known, 1.2).as_dict()
    assert printed == lm.evaluate(work / "scene.zarr", f"{work}/capture/truth.npz", 1.2).as_dict()


@pytest.mark.parametrize("words", ["", "--dense-background"])
def test_export(words: str, work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "shown").mkdir()
    _run(f"export {work}/scene.zarr {tmp_path}/shown/X.npz {words}", capsys)
    lm.export(
        tmp_path / "made" / "X.npz", lm.open(work / "scene.zarr"), dense_background=bool(words)
    )
    _same_files(tmp_path / "shown", tmp_path / "made")
    if not words:
        _same_matrix(
            lm.open(tmp_path / "made" / "X.npz").sparse, lm.open(work / "scene.zarr").sparse
        )


def _as_json(advice: Advice) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(json.dumps(advice.as_dict()))
    return read


def test_plan(work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = _run("plan metal --size 64 -k 40", capsys)
    assert printed == _as_json(lm.plan("metal", size=(64, 64), frames=40))
    by_truth = _as_json(lm.plan(lm.truth("metal"), frames=40))
    assert all(
        by_truth[key] == printed[key] for key in printed if key not in ("source", "commands")
    )
    light = np.random.default_rng(0).integers(20, 200, (20, 30)).astype(np.uint8)
    lm.write_image(tmp_path / "white.png", light)
    printed = _run(f"plan {tmp_path}/white.png --black 3 --exposure 20 --size 32x48", capsys)
    made = lm.plan(tmp_path / "white.png", black=3.0, exposure=20, size=(32, 48))
    assert printed == _as_json(made)
    assert made.make_patterns().count == made.frames


def test_the_advised_patterns_are_those_of_the_advised_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    advice = lm.plan("metal", size=(64, 64), frames=80)
    words = advice.commands[0].split()[1:-1]
    assert main([*words, str(tmp_path / "patterns")]) == 0
    assert lm.read_patterns(tmp_path / "patterns").digest == advice.make_patterns().digest
    np.testing.assert_array_equal(
        lm.simulate("metal", advice.make_patterns(), exposure=advice.exposure).exposures,
        advice.exposure_of_frames,
    )


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("-k 20 --seed 4", {"count": 20, "seed": 4}),
        (
            "-k 18 --density 0.3 --exposure 0.01 --settle 0.06 --cell 2 --no-check "
            "--response gamma:1.1",
            {
                "count": 18, "density": 0.3,
                "settings": lm.CaptureSettings(
                    cell=2, exposure=0.01, settle=0.06, response="gamma:1.1", check=False,
                ),
            },
        ),
    ],
)  # fmt: skip
def test_capture(
    words: str, arguments: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = "virtual:procedural,size=16,real=0"
    printed = _run(
        f"capture --rig {rig} {words} --rig-file {tmp_path}/shown.json -o {tmp_path}/shown", capsys
    )
    with lm.open_rig(rig) as opened:
        capture = lm.take_capture(
            tmp_path / "made", opened, keep=tmp_path / "made.json", **arguments
        )
    _same_files(tmp_path / "shown", tmp_path / "made")
    assert printed["frames"] == arguments["count"] == capture.count


@pytest.mark.parametrize("part", PARTS)
def test_rig(part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = "virtual:procedural,size=16,real=0"
    printed = _run(f"rig {part} --rig {rig} --rig-file {tmp_path}/rig.json", capsys)
    with lm.open_rig(rig) as opened:
        made = lm.measure_rig(opened, [part], keep=tmp_path / "made.json")
    assert printed[part] == json.loads(json.dumps(made.as_dict()[part]))
    shown = lm.RigMeasurements.load(tmp_path / "rig.json")
    assert {**shown.as_dict(), "measured": ""} == {
        **lm.RigMeasurements.load(tmp_path / "made.json").as_dict(), "measured": ""
    }  # fmt: skip


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_response(device: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if device == "camera":
        pytest.importorskip("cv2")
    light = np.geomspace(0.002, 1, 4000).reshape(50, 80)
    times = [0.125, 0.25, 0.5, 1, 2, 4] if device == "camera" else np.linspace(0, 1, 6) ** 2
    levels = np.array([np.rint(200 * np.clip(time * light, 0, 1)) for time in times])
    np.save(tmp_path / "s.npy", levels.astype(np.uint8))
    for name in ("shown", "made"):
        (tmp_path / name).mkdir()
    options = "--exposure 0.125,0.25,0.5,1,2,4 --clip 200" if device == "camera" else "--projector"
    made, shown = tmp_path / "made", tmp_path / "shown"
    line = f"response {tmp_path}/s.npy {options} -o {shown}/c.json --picture {shown}/c.png"
    printed = _run(line, capsys)
    files: dict[str, Any] = {"output": made / "c.json", "picture": made / "c.png"}
    if device == "camera":
        curve = lm.camera_response(tmp_path / "s.npy", np.array(times), clip=200, **files)
        assert printed["misfit"] == curve.as_dict()["misfit"]
    else:
        assert printed["gamma"] == lm.projector_response(tmp_path / "s.npy", **files).gamma
    _same_files(shown, made)


def test_every_command_is_compared_with_its_function() -> None:
    commands = {command.__name__ for members in STAGES.values() for command in members}
    # The folders of these names are not in the way of the functions take_capture and make_patterns;
    # the folder calibration is of responses too, so that its function is calibrate_rig.
    # One command for cameras and projectors, which are two functions; one for a page that is served
    # and a page that is written. A function called map would hide Python's.
    named_otherwise = {"info", "patterns", "calibrate", "capture", "response", "view", "map"}
    named_otherwise |= {"track"}  # The class Tracker.
    assert commands == {name for name in dir(lm) if name in commands} | named_otherwise


def test_choices_of_options_are_those_of_the_code() -> None:
    assert set(get_args(estimate_command.SolverName)) == set(estimate_settings.SOLVERS)
    assert set(get_args(estimate_command.FidelityName)) == set(lm.Fidelity)
    assert set(get_args(patterns_command.Kind)) == set(making.KINDS)


def test_separate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    binned(lm.truth("l_objects"), 4).save(tmp_path / "T.npz")
    lm.write_image(tmp_path / "p.png", np.tile(np.eye(8), (2, 2)))
    words = f"separate {tmp_path}/T.npz --pattern {tmp_path}/p.png -o {tmp_path}/shown"
    _run(words, capsys)
    parts = lm.separate(tmp_path / "T.npz", pattern=tmp_path / "p.png", output=tmp_path / "made")
    written = {"direct": parts.direct, "global": parts.global_}
    for name, part in written.items():
        _same_transport(lm.open(tmp_path / "shown" / f"{name}.zarr"), part)
    for name in ("separation.png", *(f"{name}.npy" for name in written)):
        one, other = (tmp_path / folder / name for folder in ("shown", "made"))
        assert one.read_bytes() == other.read_bytes()


def test_decode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = lm.make_patterns("graycode", (32, 32), inverse=True)
    lm.simulate(binned(lm.truth("metal"), 2), code, exposure=0.2).save(tmp_path / "capture")
    shown = _run(f"decode {tmp_path}/capture -o {tmp_path}/shown.npz", capsys)
    made = lm.decode(tmp_path / "capture", output=tmp_path / "made.npz")
    assert shown["decoded_share"] == made.valid.mean()
    for name in ("shown", "made"):
        (tmp_path / f"{name}s").mkdir()
        (tmp_path / f"{name}.npz").rename(tmp_path / f"{name}s" / "c.npz")
    _same_files(tmp_path / "showns", tmp_path / "mades")


def test_triangulate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = binned(lm.truth("l_objects"), 4)
    known.save(tmp_path / "T.npz")
    assert known.geometry is not None
    known.geometry.save(tmp_path / "rig.json")
    for name in ("shown", "made"):
        (tmp_path / name).mkdir()
    files = (
        f"-o {tmp_path}/shown/c.ply --depth {tmp_path}/shown/d.tif --picture {tmp_path}/shown/p.png"
    )
    scene = f"{tmp_path}/T.npz --geometry {tmp_path}/rig.json"
    limits = "--least-probability 0.9 --tolerance 0.02"
    shown = _run(f"triangulate {scene} {limits} --mesh {files}", capsys)
    made = lm.triangulate(
        tmp_path / "T.npz",
        tmp_path / "rig.json",
        least_probability=0.9,
        tolerance=0.02,
        mesh=True,
        output=tmp_path / "made" / "c.ply",
        depth=tmp_path / "made" / "d.tif",
        picture=tmp_path / "made" / "p.png",
    )
    assert shown["points"] == made.kept.sum()
    _same_files(tmp_path / "shown", tmp_path / "made")
    shown = _run(
        f"layers {scene} {limits} -o {tmp_path}/shown/l.ply --picture {tmp_path}/shown/l.png",
        capsys,
    )
    layers = lm.layers(
        tmp_path / "T.npz",
        tmp_path / "rig.json",
        least_probability=0.9,
        tolerance=0.02,
        output=tmp_path / "made" / "l.ply",
        picture=tmp_path / "made" / "l.png",
    )
    assert shown.items() >= layers.summary().items()
    _same_files(tmp_path / "shown", tmp_path / "made")
