"""Each command and its Python function give the same result, bit for bit."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.cli import estimate as estimate_command
from lightmatrix.cli import main
from lightmatrix.cli import plan as patterns_command
from lightmatrix.cli.app import STAGES
from lightmatrix.estimators import settings as estimate_settings
from lightmatrix.judgement.judgement import verdicts
from lightmatrix.patterns import making
from lightmatrix.planning.plan import Advice
from lightmatrix.rig.rig_measurements import PARTS
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import binned

T = TypeVar("T")
RIG = "virtual:procedural,size=16,real=0"


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
    rows, cols = lm.open(folder / "scene.zarr").camera_shape
    ramp = np.rint(np.tile(np.linspace(60, 255, cols), (rows, 1))).astype(np.uint8)
    lm.write_image(folder / "wanted.png", ramp)
    return folder


def _run(line: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main([*line.split(), "--json"]) == 0
    printed: dict[str, Any] = json.loads(capsys.readouterr().out)
    return printed


class Both:
    """Runs a command and its function, each in a folder of its own, and compares their files."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.shown, self.made, self._capsys = folder / "shown", folder / "made", capsys
        self.shown.mkdir()
        self.made.mkdir()

    def __call__(self, line: str, function: Callable[[], T]) -> tuple[dict[str, Any], T]:
        with contextlib.chdir(self.shown):
            printed = _run(line, self._capsys)
        with contextlib.chdir(self.made):
            result = function()
        self._compare()
        return printed, result

    def _compare(self) -> None:
        names = sorted(p.relative_to(self.shown) for p in self.shown.rglob("*") if p.is_file())
        assert names
        assert names == sorted(
            p.relative_to(self.made) for p in self.made.rglob("*") if p.is_file()
        )
        for name in names:
            one, other = self.shown / name, self.made / name
            if name.suffix == ".npz":  # Archives keep times.
                with np.load(one) as a, np.load(other) as b:
                    assert set(a.files) == set(b.files)
                    for key in a.files:
                        np.testing.assert_array_equal(a[key], b[key])
            elif ".zarr" not in str(name):  # Its provenance names the files.
                assert one.read_bytes() == other.read_bytes(), name


@pytest.fixture
def both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Both:
    return Both(tmp_path, capsys)


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


@pytest.mark.parametrize("kind", making.KINDS)
def test_patterns(kind: str, both: Both) -> None:
    # Gray code has as many patterns as it needs, with and without sinusoids.
    count = None if kind in ("graycode", "phase") else 12
    words = "" if count is None else f"-k {count} "
    made = lm.make_patterns(kind, (16, 8), count, block=(4, 2), seed=3)
    printed, _ = both(
        f"patterns {kind} {words}--size 16x8 --block 4x2 --seed 3 -o out",
        lambda: lm.write_patterns("out", made),
    )
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
            "--full-well 10000 --noise 0.01 --seed 5",
            {
                "leak": 0.02, "ambient": 0.1, "black_level": 4, "blur": 0.7, "vignetting": 0.3,
                "full_well": 10_000, "noise": 0.01, "seed": 5,
            },
        ),
    ],
)  # fmt: skip
def test_simulate(words: str, settings: dict[str, Any], work: Path, both: Both) -> None:
    capture = lm.simulate(f"{work}/T.npz", lm.read_patterns(work / "patterns"), **settings)
    printed, _ = both(
        f"simulate {work}/T.npz --patterns {work}/patterns {words} -o out",
        lambda: capture.save("out"),
    )
    # The capture in memory equals the one that is read back, so that an estimate needs no folder.
    read = lm.Capture.open(both.shown / "out")
    assert read.digest == capture.digest
    assert read.description == capture.description
    assert printed["frames"] == sum(printed["exposures"].values()) == 48
    _same_matrix(lm.truth(f"{both.shown}/out/truth.npz").matrix, capture.truth.matrix)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("", {}),
        ("--no-coherent", {"coherent": False}),
        ("--solver romp --fidelity linear", {"solver": "romp", "fidelity": "linear"}),
        ("--solver total-variation --iterations 9", {"solver": "total-variation", "iterations": 9}),
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
def test_estimate(words: str, settings: dict[str, Any], work: Path, both: Both) -> None:
    # The checks, which take longest, with the first settings only.
    unchecked = "--no-check" if words else ""
    printed, made = both(
        f"estimate {work}/capture {words} {unchecked} -o out.zarr",
        lambda: lm.estimate(work / "capture", output="out.zarr", check=not unchecked, **settings),
    )
    shown, kept = (lm.open(folder / "out.zarr") for folder in (both.shown, both.made))
    _same_transport(shown, made)
    _same_transport(shown, kept)
    assert shown.provenance == kept.provenance
    summary = shown.summary()
    assert {name: printed[name] for name in summary} == summary


def test_estimate_from_two_binned_folders(work: Path, both: Both) -> None:
    images = work / "capture" / "images"
    bins = "--bin-camera 2 --bin-projector 2x1 --clip 250 --no-check"
    capture = lm.Capture.from_folders(
        work / "patterns", images, lm.ReadSettings(clip=250), bin_camera=2, bin_projector=(2, 1)
    )
    _, made = both(
        f"estimate --patterns {work}/patterns --images {images} {bins} -o out.zarr",
        lambda: lm.estimate(capture, output="out.zarr", check=False),
    )
    _same_transport(lm.open(both.shown / "out.zarr"), made)


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
# The geometry is not that of the scene.
@pytest.mark.filterwarnings("ignore:.*epipolar line")
def test_show(
    words: str, view: str, index: tuple[int, ...], work: Path, tmp_path: Path, both: Both
) -> None:
    camera = np.array([[10.0, 0, 5, 0], [0, 10, 5, 0], [0, 0, 1, 0]])
    projector = np.array([[10.0, 0, 4, 5], [0, 10, 4, 0], [0, 0, 1, 0]])
    rig = lm.RigGeometry(camera, projector, (12, 11), (8, 8))
    rig.save(tmp_path / "rig.json")
    name = words.split()[-1]
    geometry = rig if "--geometry" in words else None
    printed, _ = both(
        f"show {work}/scene.zarr {words}",
        lambda: lm.show(work / "scene.zarr", view, *index, geometry=geometry, output=name),
    )
    assert printed == {"output": name, "view": view}


@pytest.mark.parametrize("name", ["out.PNG", "out.npy", "out.exr"])
def test_relight(name: str, work: Path, both: Both) -> None:
    if name.endswith("exr"):
        pytest.importorskip("OpenEXR")
    pattern = work / "patterns" / "pattern_0003.png"
    gamma = 2.2 if name.lower().endswith("png") else 1.0
    printed, image = both(
        f"relight {work}/scene.zarr {pattern} --exposure 0.7 --gamma {gamma} -o {name}",
        lambda: lm.relight(work / "scene.zarr", pattern, exposure=0.7, gamma=gamma, output=name),
    )
    assert printed["mean"] == float(image.mean())
    written = lm.read_image(both.made / name)
    if gamma == 2.2:
        expected = np.rint(255 * np.clip(image, 0, 1) ** (1 / 2.2))
        np.testing.assert_allclose(written, expected, atol=1)
    else:
        np.testing.assert_array_equal(written, image)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("-o x.png", {}),
        ("-o x.npy --brightness 0.4 --gamma 2.2", {"brightness": 0.4, "gamma": 2.2}),
        ("-o x.tiff --mask {wanted} --black {black}", {"mask": "{wanted}", "ambient": "{black}"}),
    ],
)
def test_compensate(
    words: str, settings: dict[str, Any], work: Path, tmp_path: Path, both: Both
) -> None:
    names = {"wanted": work / "wanted.png", "black": tmp_path / "black.png"}
    lm.write_image(names["black"], np.full((12, 11), 3, np.uint8))
    scene, output = work / "scene.zarr", words.split()[1]
    settings = {k: v.format(**names) if isinstance(v, str) else v for k, v in settings.items()}
    told, found = both(
        f"compensate {scene} {names['wanted']} {words.format(**names)}",
        lambda: lm.compensate(scene, names["wanted"], output=output, **settings),
    )
    assert told == {"output": output, **found.as_dict()}


def test_compensate_with_two_projectors(work: Path, both: Both) -> None:
    scene, wanted = work / "scene.zarr", work / "wanted.png"
    both(
        f"compensate {scene} {wanted} --beside {scene} -o x.png",
        lambda: lm.compensate([scene, scene], wanted, output="x.png"),
    )
    assert (both.made / "x-2.png").exists()


def test_compensate_a_video(work: Path, tmp_path: Path, both: Both) -> None:
    scene, frames = work / "scene.zarr", tmp_path / "frames"
    frames.mkdir()
    picture = lm.read_image(work / "wanted.png")
    for k in range(3):
        lm.write_image(frames / f"{k}.png", np.roll(picture, k, axis=1))
    told, video = both(
        f"compensate {scene} {frames} -o out",
        lambda: lm.compensate_video(scene, frames, output="out"),
    )
    assert told == {"output": "out", **video.as_dict()}


def test_compensate_cancels_global_light(tmp_path: Path, both: Both) -> None:
    scene = tmp_path / "scene.zarr"
    lm.save(scene, binned(lm.truth("l_objects"), 4).transport())
    told, found = both(
        f"compensate {scene} --cancel-global -o x.png",
        lambda: lm.cancel_global(scene, output="x.png"),
    )
    assert told == {"output": "x.png", **found.as_dict()}


def test_compensate_on_a_rig(tmp_path: Path, both: Both) -> None:
    known = lm.ProceduralScene((16, 16), (16, 16), 0).truth().transport()
    scene, wanted = tmp_path / "scene.zarr", tmp_path / "wanted.png"
    lm.save(scene, known)
    lm.write_image(wanted, np.full((16, 16), 150, np.uint8))
    with lm.open_rig(RIG) as opened:
        told, found = both(
            f"compensate {scene} {wanted} --rig {RIG} --refine 2 --settle 0.2 "
            "--rig-file ../rig.json -o x.png",
            lambda: lm.refine_compensation(
                opened, known, wanted, steps=2, settle=0.2, output="x.png"
            ),
        )
    kept = lm.RigMeasurements.load(tmp_path / "rig.json").settle
    assert kept is not None
    assert kept.seconds == 0.2
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
    assert main(line.format(wanted=work / "wanted.png").split()) == 2
    assert reason in capsys.readouterr().err


def test_evaluate(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = _run(f"evaluate {work}/scene.zarr --truth {work}/T.npz --exposure 1.2", capsys)
    estimate, known = lm.open(work / "scene.zarr"), lm.truth(f"{work}/T.npz")
    assert printed == lm.evaluate(estimate, known, 1.2).as_dict()
    assert printed == lm.evaluate(work / "scene.zarr", f"{work}/capture/truth.npz", 1.2).as_dict()


@pytest.mark.parametrize("words", ["", "--dense-background"])
def test_export(words: str, work: Path, both: Both) -> None:
    scene = lm.open(work / "scene.zarr")
    both(
        f"export {work}/scene.zarr X.npz {words}",
        lambda: lm.export("X.npz", scene, dense_background=bool(words)),
    )
    if not words:
        _same_matrix(lm.open(both.made / "X.npz").sparse, scene.sparse)


def _as_json(advice: Advice) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(json.dumps(advice.as_dict()))
    return read


def test_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_the_advised_patterns_are_those_of_the_advised_command(tmp_path: Path) -> None:
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
def test_capture(words: str, arguments: dict[str, Any], both: Both) -> None:
    with lm.open_rig(RIG) as opened:
        printed, capture = both(
            f"capture --rig {RIG} {words} --rig-file ../shown.json -o out",
            lambda: lm.take_capture("out", opened, keep="../made.json", **arguments),
        )
    assert printed["frames"] == arguments["count"] == capture.count


@pytest.mark.parametrize("part", PARTS)
def test_rig(part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = _run(f"rig {part} --rig {RIG} --rig-file {tmp_path}/rig.json", capsys)
    with lm.open_rig(RIG) as opened:
        made = lm.measure_rig(opened, [part], keep=tmp_path / "made.json")
    assert printed[part] == json.loads(json.dumps(made.as_dict()[part]))
    shown, kept = (
        lm.RigMeasurements.load(tmp_path / f"{x}.json").as_dict() for x in ("rig", "made")
    )
    assert shown | {"measured": ""} == kept | {"measured": ""}


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_response(device: str, tmp_path: Path, both: Both) -> None:
    light = np.geomspace(0.002, 1, 4000).reshape(50, 80)
    times = [0.125, 0.25, 0.5, 1, 2, 4] if device == "camera" else np.linspace(0, 1, 6) ** 2
    levels = np.array([np.rint(200 * np.clip(time * light, 0, 1)) for time in times])
    np.save(tmp_path / "s.npy", levels.astype(np.uint8))
    line = f"response {tmp_path}/s.npy -o c.json --picture c.png"
    files: dict[str, Any] = {"output": "c.json", "picture": "c.png"}
    if device == "camera":
        pytest.importorskip("cv2")
        printed, curve = both(
            f"{line} --exposure 0.125,0.25,0.5,1,2,4 --clip 200",
            lambda: lm.camera_response(tmp_path / "s.npy", np.array(times), clip=200, **files),
        )
        assert printed["misfit"] == curve.as_dict()["misfit"]
    else:
        printed, found = both(
            f"{line} --projector", lambda: lm.projector_response(tmp_path / "s.npy", **files)
        )
        assert printed["gamma"] == found.gamma


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


def test_separate(tmp_path: Path, both: Both) -> None:
    binned(lm.truth("l_objects"), 4).save(tmp_path / "T.npz")
    lm.write_image(tmp_path / "p.png", np.tile(np.eye(8), (2, 2)))
    _, parts = both(
        f"separate {tmp_path}/T.npz --pattern {tmp_path}/p.png -o out",
        lambda: lm.separate(tmp_path / "T.npz", pattern=tmp_path / "p.png", output="out"),
    )
    for name, part in (("direct", parts.direct), ("global", parts.global_)):
        _same_transport(lm.open(both.shown / "out" / f"{name}.zarr"), part)


def test_decode(tmp_path: Path, both: Both) -> None:
    code = lm.make_patterns("graycode", (32, 32), inverse=True)
    lm.simulate(binned(lm.truth("metal"), 2), code, exposure=0.2).save(tmp_path / "capture")
    shown, made = both(
        f"decode {tmp_path}/capture -o c.npz",
        lambda: lm.decode(tmp_path / "capture", output="c.npz"),
    )
    assert shown["decoded_share"] == made.valid.mean()


def test_triangulate(tmp_path: Path, both: Both) -> None:
    known = binned(lm.truth("l_objects"), 4)
    known.save(tmp_path / "T.npz")
    assert known.geometry is not None
    known.geometry.save(tmp_path / "rig.json")
    files = (tmp_path / "T.npz", tmp_path / "rig.json")
    scene = f"{files[0]} --geometry {files[1]} --least-probability 0.9 --tolerance 0.02"
    limits: dict[str, Any] = {"least_probability": 0.9, "tolerance": 0.02}
    shown, made = both(
        f"triangulate {scene} --mesh -o c.ply --depth d.tif --picture p.png",
        lambda: lm.triangulate(
            *files, **limits, mesh=True, output="c.ply", depth="d.tif", picture="p.png"
        ),
    )
    assert shown["points"] == made.kept.sum()
    shown, layers = both(
        f"layers {scene} -o l.ply --picture l.png",
        lambda: lm.layers(*files, **limits, output="l.ply", picture="l.png"),
    )
    assert shown.items() >= layers.summary().items()
