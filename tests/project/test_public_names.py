"""`import lightmatrix as lm`: its names, their examples, and what they load."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from docs_site import returned_classes

import lightmatrix as lm
from lightmatrix.cli.app import GROUPS, STAGES
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.multiscale import MultiScaleEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.rig.devices import registry

HEAVY = ("numpy", "scipy", "matplotlib", "zarr", "rich", "typer", "PIL")
NAMES = sorted(name for name in dir(lm) if not name.startswith("_"))
# Errors have no example: their names say what they are.
PLAIN = {"InputError", "OutputError", "SolverError", "MissingExtraError", "LightMatrixWarning"}
PLAIN |= {"ClusterError", "DeviceError", "FrameTimeoutError"}


@pytest.fixture(autouse=True)
def _a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # No example shows cameras, and the search for them takes seconds.
    cameras = {kind: replace(back, find=None) for kind, back in registry.CAMERAS.items()}
    monkeypatch.setattr(registry, "CAMERAS", cameras)


def _loaded(code: str) -> set[str]:
    """The modules that a fresh Python has loaded after some code."""
    tail = "\nimport sys; sys.stderr.write(' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code + tail], capture_output=True, text=True, check=True
    )
    return set(done.stderr.split())


def test_the_import_loads_nothing_heavy() -> None:
    assert not _loaded("import lightmatrix").intersection(HEAVY)


def test_help_loads_no_more_than_it_needs() -> None:
    loaded = _loaded("from lightmatrix.cli import main; assert main(['estimate', '--help']) == 0")
    assert not loaded.intersection({"numpy", "scipy", "scipy.signal", "matplotlib", "zarr"})
    assert "lightmatrix.cli.estimate" in loaded


def test_an_estimate_loads_no_more_than_it_needs() -> None:
    """Statistics and signal processing would take half of its start."""
    loaded = _loaded("import lightmatrix as lm; lm.EstimateSettings, lm.Capture")
    assert "scipy.sparse" in loaded
    assert not loaded.intersection({"scipy.signal", "scipy.stats", "scipy.optimize"})


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("info T.zarr", 0),
        ("relight T.zarr pattern.npy -o image.npy", 0),
        ("estimate nothing -o scene.zarr", 2),
        ("triangulate T.zarr --geometry nothing.json -o cloud.ply", 2),
    ],
)
def test_commands_load_no_library_that_they_do_not_use(words: str, code: int) -> None:
    """A lazy module of Zarr or tifffile may be there, but nothing that it would load."""
    lm.save("T.zarr", lm.truth("metal").transport())
    np.save("pattern.npy", np.ones(lm.truth("metal").projector_shape, np.float32))
    loaded = _loaded(f"from lightmatrix.cli import main; assert main({words.split()}) == {code}")
    assert "lightmatrix.files.zarr_arrays" in loaded
    unused = {"zarr.core", "asyncio", "tifffile.tifffile", "matplotlib", "jinja2"}
    scipy = ("ndimage", "optimize", "interpolate", "spatial", "signal", "stats")
    assert not loaded.intersection(unused | {f"scipy.{name}" for name in scipy})


# A refusal of each command that takes an input.
REFUSALS = """
plan nothing.png
patterns bernoulli -k 0 -o patterns
capture -o capture
convert nothing
response nothing -o curve.json
calibrate nothing --board 9x7 --square 24mm
rig settle --rig virtual:nothing
check nothing
pack nothing
estimate nothing -o new.zarr
track nothing -o new.zarr
decode nothing -o new.npz
info nothing.zarr
show nothing.zarr dual -o new.png
view nothing.zarr --no-browser
relight nothing.zarr white.png -o new.png
separate nothing.zarr -o parts
compensate nothing.zarr wanted.png -o new.png
project nothing.png --rig virtual:metal
map nothing.zarr -o new.exr
triangulate nothing.zarr --geometry nothing.json -o new.ply
layers nothing.zarr --geometry nothing.json -o new.ply
evaluate nothing.zarr metal
export nothing.zarr new.npz
render nothing -o new.npz
simulate nothing --patterns nothing -o new
demo -o .
"""
ALL_REFUSALS = """
import sys
from lightmatrix.cli import main
for words in sys.argv[2].strip().splitlines():
    assert main(words.split()) == 2, words
    heavy = set(sys.argv[1].split()).intersection(sys.modules)
    assert not heavy, f"{words} loads {heavy}"
"""


def test_refusals_load_no_library_that_works() -> None:
    """None of these is needed to refuse bad input, and each takes 0.03 to 0.3 s to load."""
    commands = {words.split()[0] for words in REFUSALS.strip().splitlines()}
    every = {member.__name__ for members in STAGES.values() for member in members}
    assert commands == every.union(*GROUPS.values()) - {"scenes"}
    scipy = ("linalg", "ndimage", "optimize", "interpolate", "signal", "spatial", "special")
    heavy = {"zarr.core", "matplotlib.figure", "cv2", "dask", *(f"scipy.{one}" for one in scipy)}
    words = [sys.executable, "-c", ALL_REFUSALS, " ".join(heavy), REFUSALS]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_objects_with_arrays_are_shown_in_a_few_lines() -> None:
    with_arrays = [
        kind
        for kind in (getattr(lm, name) for name in NAMES)
        if is_dataclass(kind) and any("array" in str(field.type).lower() for field in fields(kind))
    ]
    assert lm.Correspondence in with_arrays
    # The `__repr__` that dataclasses make themselves is wrapped, and prints whole arrays.
    assert [kind for kind in with_arrays if hasattr(kind.__repr__, "__wrapped__")] == []


def test_tab_shows_the_names_and_nothing_else() -> None:
    assert {"Capture", "LightTransport", "estimate", "open", "save", "simulate"} <= set(NAMES)
    assert {"plan", "evaluate", "relight", "export", "scenes", "show"} <= set(NAMES)
    assert not any(isinstance(getattr(lm, name), ModuleType) for name in NAMES)
    with pytest.raises(AttributeError):
        lm.nothing_of_that_name  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.usefixtures("unchecked")
@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
@pytest.mark.parametrize("name", NAMES)
def test_every_name_has_an_example_that_runs(name: str) -> None:
    _run_example(name, getattr(lm, name))


def test_classes_of_results_have_examples_that_run() -> None:
    for each in {each for name in NAMES for each in returned_classes(getattr(lm, name))}:
        if "Examples\n" in (each.__doc__ or ""):
            _run_example(each.__name__, each)


def test_help_begins_with_names_that_are_there() -> None:
    first = re.findall(r"^    (\w+)  ", lm.__doc__ or "", flags=re.MULTILINE)
    assert set(first) <= set(NAMES)
    assert len(first) >= 20
    assert len(NAMES) <= 115


def _run_example(name: str, thing: Any) -> None:
    assert thing.__doc__, name
    if name in PLAIN:
        return
    assert "Examples\n" in thing.__doc__, f"{name} has no example"
    parser = doctest.DocTestParser()
    test = parser.get_doctest(thing.__doc__, {"np": np}, name, None, 0)
    assert test.examples
    runner = doctest.DocTestRunner(verbose=False)
    output: list[str] = []
    runner.run(test, out=output.append)
    assert runner.failures == 0, "".join(output)


def test_nothing_dumps_its_arrays() -> None:
    capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    transport = capture.truth.transport()
    result = lm.solve(
        lm.Problem(capture.patterns, capture.samples(0, 4), 0.1), lm.ROMP(max_iterations=1)
    )
    patterns = lm.ImagePatterns(np.zeros((2, 40, 50), np.float32))
    things = [capture, capture.truth, capture.sensor, capture.decoder, capture.samples()]
    things += [transport, patterns, result, lm.Problem(capture.patterns, capture.samples(), 0.1)]
    things += [lm.BlockPatterns((64, 64), (8, 8), np.arange(40)), capture.frames]
    for thing in things:
        text = repr(thing)
        assert "array(" not in text
        assert "\n" not in text
        assert len(text) < 420, text
        assert type(thing).__name__.removeprefix("Simulated") in text
    for thing in (capture, transport):
        shown = thing._repr_html_()
        assert shown.startswith("<table>")
        assert len(shown) < 10_000
        assert "64 x 64" in shown
    assert "<img" in transport._repr_html_()


def test_names_in_a_notebook_are_text() -> None:
    transport = lm.truth("metal").transport()
    odd = lm.LightTransport(
        transport.sparse,
        transport.background,
        transport.camera_shape,
        transport.projector_shape,
        provenance={"estimator": "<script>"},
    )
    assert "<script>" not in odd._repr_html_()
    assert "&lt;script&gt;" in odd._repr_html_()


def test_raw_levels_are_no_pattern() -> None:
    transport = lm.truth("metal").transport()
    with pytest.raises(lm.InputError, match="divide raw levels by their largest one, such as 255"):
        transport.relight(np.full((64, 64), 255, np.uint8))
    lit = transport.relight(np.ones((64, 64), bool))
    np.testing.assert_array_equal(lit, transport.relight(np.ones((64, 64))))


@pytest.mark.parametrize(
    "settings",
    [
        {"solver": "simplex"},
        {"fidelity": "hope"},
        {"solver": "admm", "fidelity": "one-sided"},
        {"regularization": 0},
        {"regularization": 1e308},
        {"regularization": float("nan")},
        {"regularization": "maybe"},
        {"iterations": 0},
        {"iterations": 2**32},
        {"tile_rows": 0},
        {"multi_scale": True, "coherent": True},
        {"signed": True, "coherent": True},
        {"solver": "active-set", "fidelity": "clipped"},
    ],
)
def test_settings_are_refused_before_anything_is_read(settings: dict[str, object]) -> None:
    with pytest.raises(lm.LightMatrixError) as error:
        lm.estimate("no such folder", **settings)  # type: ignore[arg-type]
    assert "no such folder" not in error.value.message
    assert error.value.hint
    assert not list(Path().iterdir())


def test_a_chosen_estimator_is_the_one_that_was_asked_for() -> None:
    few = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
    assert isinstance(choose_estimator(few), CoherentEstimator)
    for settings in ({"coherent": False}, {"signed": True}, {"solver": "romp"}):
        assert isinstance(choose_estimator(few, lm.EstimateSettings(**settings)), PlainEstimator)
    scaled = choose_estimator(few, lm.EstimateSettings(multi_scale=True))
    assert isinstance(scaled, MultiScaleEstimator)
    many = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 257))
    assert isinstance(choose_estimator(many), PlainEstimator)
