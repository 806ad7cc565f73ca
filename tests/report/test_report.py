"""The report: its content, and how it looks in a real browser."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from browser import installed, opened
from playwright.sync_api import Browser

import lightmatrix as lm
from lightmatrix.check.finding import Finding
from lightmatrix.cli import main
from lightmatrix.pictures import maps
from lightmatrix.report import elements
from lightmatrix.report import facts as report_facts
from lightmatrix.report import sections as uses
from lightmatrix.report.facts import Facts
from lightmatrix.report.make import recommendations
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import SimulatedCapture
from lightmatrix.simulation.truth import binned

pytestmark = pytest.mark.usefixtures("unchecked")
NOISE = 0.003


@pytest.fixture(scope="module")
def capture() -> SimulatedCapture:
    truth = ProceduralScene((20, 24), (16, 16), seed=1, bounces=3).truth()
    return lm.simulate(truth, lm.BernoulliPatterns((16, 16), 40), exposure=0.9, noise=NOISE)


@pytest.fixture(scope="module")
def estimate(capture: SimulatedCapture) -> lm.LightTransport:
    return lm.estimate(capture)


@pytest.fixture(scope="module")
def written(
    capture: SimulatedCapture, estimate: lm.LightTransport,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:  # fmt: skip
    """A report with every optional part, and a title that must not be read as markup."""
    folder = tmp_path_factory.mktemp("written") / "report"
    rows = np.arange(len(estimate.background))
    complete = replace(
        estimate,
        diagnostics={
            **estimate.diagnostics,
            "footprint": np.where(rows % 7, 1 + rows % 5, np.nan).astype(np.float32),
            "estimated_error": (0.001 * (1 + rows % 50)).astype(np.float32),
        },
    )
    lm.report(folder, complete, capture, truth=capture.truth, title="<b>odd & title</b>")
    return folder


def _words(file: Path) -> str:
    """The text of a page, without its pictures."""
    text = re.sub(r"<style>.*?</style>|<[^>]+>", " ", file.read_text(), flags=re.DOTALL)
    return " ".join(text.split())


def test_the_page_is_self_contained(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert len(page.encode()) < 5_000_000
    assert "<script" not in page
    assert "&lt;b&gt;odd &amp; title&lt;/b&gt;" in page
    addresses = re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?([^\"')\s>]+)", page)
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert all(f'id="{anchor[1:]}"' in page for anchor in addresses if anchor.startswith("#"))
    pictures = re.findall(r"<img [^>]*>", page)
    assert len(pictures) > 40
    assert all(re.search(r'alt="[^"]{2,}"', picture) for picture in pictures)


def test_the_viewer_is_beside_the_page_when_asked_for(
    tmp_path: Path, estimate: lm.LightTransport, capture: lm.Capture
) -> None:
    lm.report(tmp_path / "r", estimate, capture, held_out=False, viewer=True)
    assert 'href="viewer.html"' in (tmp_path / "r" / "report.html").read_text()
    assert "<script" in (tmp_path / "r" / "viewer.html").read_text()


def test_depth_and_normals_are_shown_where_the_geometry_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    known = lm.truth("l_objects")
    assert known.geometry is not None
    monkeypatch.chdir(tmp_path)
    known.geometry.save("rig.json")
    binned(known, 2).save(tmp_path / "T.npz")
    for line in (
        "patterns bernoulli -k 24 --size 32x32 -o patterns",
        "simulate T.npz --patterns patterns --exposure 0.5 -o capture",
    ):
        assert main(line.split()) == 0
    run = "estimate capture -o scene.zarr --geometry rig.json"
    assert main(run.split()) == 2
    assert "--geometry without --report" in capsys.readouterr().err
    assert main([*run.split(), "--report", "report", "--viewer"]) == 0
    words = _words(tmp_path / "report" / "report.html")
    for phrase in ("pixels have a depth; its median is", "Depth", "Normals", "scene unit"):
        assert phrase in words, phrase
    viewer = (tmp_path / "report" / "viewer.html").read_text()
    assert all(f"layer-{name}" in viewer for name in ("depth", "behind", "mirrors", "probability"))
    # A geometry whose lines the light does not lie on does not spoil the rest.
    across, down, one = known.geometry.projector_matrix
    upset = replace(known.geometry, projector_matrix=np.array([across, 63 * one - down, one]))
    upset.save("upset.json")
    line = "estimate capture -o upset.zarr --report upset --geometry upset.json --viewer"
    assert main(line.split()) == 0
    assert "There is no shape: " in _words(tmp_path / "upset" / "report.html")
    known.geometry.cropped((0, 0), (63, 60)).save("other.json")
    line = "estimate capture -o other.zarr --report other --geometry other.json"
    assert main(line.split()) == 2
    assert "camera images of 63 x 60 pixels" in capsys.readouterr().err
    assert not (tmp_path / "other.zarr").exists()


def test_the_page_has_its_sections_and_numbers(written: Path, estimate: lm.LightTransport) -> None:
    words = _words(written / "report.html")
    numbers = json.loads((written / "report.json").read_text())
    assert numbers["verdict"] in ("good", "fair")
    assert numbers["sentence"] in words
    for phrase in (
        "Pattern: stripes", "Clipped samples per frame",
        "duality gap (largest)", "Estimated error per camera pixel", "Prediction minus photograph",
        "Projector row", "Projector column", "Confidence", "Footprint size", "Background",
        "Dual image", "Row of camera pixel", "Column of projector pixel", "The truth",
        "Error against the truth", "Direct light", "Global light", "Recommendations",
        "pattern digest",
        str(estimate.provenance["pattern_digest"]), "versions: numpy",
    ):  # fmt: skip
        assert phrase in words, phrase


def test_the_numbers_are_those_of_the_estimate(
    written: Path, capture: SimulatedCapture, estimate: lm.LightTransport
) -> None:
    numbers = json.loads((written / "report.json").read_text())
    assert numbers["relative_error"] == lm.evaluate(estimate, capture.truth).relative_error
    assert numbers["clipped_samples"] == pytest.approx(capture.clipped_share)
    assert len(numbers["held_out_frames"]) == 4
    assert numbers["held_out_error"] < 0.3 * numbers["mean_photograph_error"]


def test_uses_of_large_and_of_dark_matrices_are_a_sentence(
    capture: SimulatedCapture, estimate: lm.LightTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = Facts(estimate, capture, None, "")
    assert {element.kind for element in uses.uses(facts).elements} == {"text", "gallery"}
    dark = replace(estimate, sparse=0 * estimate.sparse, background=0 * estimate.background)
    texts = uses.uses(replace(facts, transport=dark)).elements
    assert [element.kind for element in texts] == ["text"]
    assert "cannot be separated: 0 of 480 camera pixels" in getattr(texts[0], "text", "")
    monkeypatch.setattr(uses, "_MOST_SAMPLES", 479)
    (only,) = uses.uses(facts).elements
    assert "lightmatrix separate" in getattr(only, "text", "")


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_an_estimate_without_diagnostics_has_a_report_too(tmp_path: Path) -> None:
    """Colour, two exposures, bins, a mask, all rows dark on one side, no truth, no diagnostics."""
    patterns = lm.BernoulliPatterns((8, 8), 6)
    frames = np.random.default_rng(0).integers(0, 250, (6, 10, 12, 3)).astype(np.uint8)
    frames[:, :, :6] = 0
    frames[1, 3:5] = 255
    mask = np.ones((10, 12, 3), bool)
    mask[:, -2:] = False
    sensor = lm.Sensor(np.array([1.0, 0.25] * 3))
    capture = lm.Capture.from_arrays(patterns, frames, sensor, mask=mask).bin(camera=2)
    estimate = lm.estimate(capture, solver="romp", iterations=2)
    bare = replace(estimate, diagnostics={}, provenance={})
    finding = Finding("order", (2, 4), "two frames look swapped", "swap them")
    numbers = lm.report(tmp_path / "report", bare, capture, findings=[finding])
    assert numbers["findings"] == ["order"]
    assert numbers["verdict"] == "not tested"
    assert numbers["clipped_samples"] == pytest.approx(capture.clipped_share)
    words = _words(tmp_path / "report" / "report.html")
    assert "6 photographs are too few" in words
    assert "clip, exposure 0.25" in words
    assert "Problems of the frames Two frames look swapped (frames 2, 4). Swap them." in words


def test_a_capture_of_another_rig_is_refused(
    capture: SimulatedCapture, estimate: lm.LightTransport, tmp_path: Path
) -> None:
    with pytest.raises(lm.InputError, match=r"the estimate's camera shape is \(20, 24\), the cap"):
        lm.report(tmp_path / "report", estimate, capture.bin(camera=2))
    assert not list(tmp_path.iterdir())


def test_estimate_writes_a_report(
    capture: SimulatedCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    capture.save(tmp_path / "capture")
    monkeypatch.chdir(tmp_path)
    assert main(["estimate", "capture", "--report", "report", "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)["report"]
    assert numbers == json.loads(Path("report/report.json").read_text())
    # A simulated capture holds its truth.
    assert numbers["relative_error"] is not None
    assert main(["estimate", "capture", "--report", "report", "-o", "other.zarr"]) == 2
    assert "report: exists already" in capsys.readouterr().err
    assert not Path("other.zarr").exists()


def test_pictures_stay_small_whatever_they_show() -> None:
    """About 40 of them stay below 5 MB."""
    noise = np.random.default_rng(0).random((1000, 900, 3))
    errors = maps.error_map(noise[..., 0])
    pictures = (
        elements.photograph(noise, "noise"),
        elements.pattern_image(noise[..., 0], "noise", "noise"),
        elements.difference_image(noise - 0.5, 1, "noise", "noise"),
        elements.faint_image(noise[..., 0], "noise", "noise"),
        elements.image_of_map(errors),
    )
    for picture in pictures:
        assert len(picture.source) < 150_000
        assert max(picture.width, picture.height) <= elements.MOST_PIXELS


def test_small_differences_are_visible() -> None:
    """A scale that ends far above all of them would show an even grey."""
    small = 0.02 * np.random.default_rng(0).standard_normal((40, 40))
    shown = elements.difference_image(small, 0.01, "small", "small")
    assert shown.scale is not None
    assert 0.04 < float(shown.scale.high) < 0.07
    noise = elements.difference_image(small / 100, 0.01, "noise", "noise")
    assert noise.scale is not None
    assert float(noise.scale.high) == pytest.approx(0.01)


# ---- unseen photographs


class _Known:
    """An estimator that returns a fixed matrix and records its captures."""

    def __init__(self, matrix: lm.LightTransport) -> None:
        self.matrix = matrix
        self.seen: list[lm.Capture] = []

    def estimate(self, capture: lm.Capture, *, progress: Any = None) -> lm.LightTransport:
        self.seen.append(capture)
        return self.matrix


def test_the_second_estimate_does_not_see_the_frames(capture: SimulatedCapture) -> None:
    estimator = _Known(capture.truth.transport())
    tested = report_facts.validate(capture, estimator)
    assert isinstance(tested, report_facts.Validation)
    seen = estimator.seen[0]
    assert seen.count == capture.count - len(tested.frames) == tested.others
    for index in tested.frames:
        frame = capture.frame(int(index))
        assert not any((seen.frame(k) == frame).all() for k in range(seen.count))
    # The truth predicts them up to the noise; a black matrix misses all light.
    level = float(np.sqrt(np.mean(np.square(tested.photographs))))
    assert tested.error < 2 * NOISE / level
    black = lm.LightTransport.from_matrix(
        0 * capture.truth.matrix, capture.camera_shape, capture.projector_shape
    )
    nothing = report_facts.validate(capture, _Known(black))
    assert isinstance(nothing, report_facts.Validation)
    assert nothing.error == pytest.approx(1)
    assert tested.mean_error > 10 * tested.error


def test_large_cameras_are_tested_on_a_part(
    capture: SimulatedCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_facts, "MOST_ROWS", 100)
    seen: list[lm.Capture] = []

    class Cropped:
        def estimate(self, capture: lm.Capture, *, progress: Any = None) -> lm.LightTransport:
            seen.append(capture)
            return lm.estimate(capture, coherent=False, iterations=20)

    tested = report_facts.validate(capture, Cropped())
    assert isinstance(tested, report_facts.Validation)
    assert tested.region is not None
    rows, cols = tested.region
    whole = capture.samples().values.reshape(*capture.camera_shape, -1)[rows, cols]
    kept = np.setdiff1d(np.arange(capture.count), tested.frames)
    shown = seen[0].samples().values.reshape(*whole.shape[:2], -1)
    np.testing.assert_array_equal(shown, whole[..., kept])
    assert 50 < seen[0].rows <= 100


class _Untouched:
    def estimate(self, capture: lm.Capture, *, progress: Any = None) -> lm.LightTransport:
        raise AssertionError("nothing can be tested")


def test_photographs_that_follow_from_others_are_not_predicted() -> None:
    truth = ProceduralScene((8, 8), (16, 16), seed=1, bounces=1).truth()
    stripes = np.stack([(np.arange(16) >> bit & 1) * np.ones((16, 1)) for bit in range(4)])
    gray = np.concatenate([stripes, 1 - stripes, np.ones((1, 16, 16))]).astype(np.float32)
    base = lm.BernoulliPatterns((16, 16), 2).rows(0, 2).reshape(2, 16, 16)
    twice = np.repeat(base, 8, axis=0)
    for patterns in (lm.ImagePatterns(gray), lm.ImagePatterns(twice)):
        simulated = lm.simulate(truth, patterns)
        assert "whatever T is" in str(report_facts.validate(simulated, _Untouched()))
    few = lm.simulate(truth, lm.BernoulliPatterns((16, 16), 7))
    assert report_facts.validate(few, _Untouched()) == "7 photographs are too few to hold any out"


def test_what_explains_an_unseen_photograph_is_not_seen_either() -> None:
    truth = ProceduralScene((8, 8), (16, 16), seed=1, bounces=1).truth()
    base = lm.BernoulliPatterns((16, 16), 16).rows(0, 16).reshape(16, 16, 16)
    pairs = lm.ImagePatterns(np.stack([base, 1 - base], axis=1).reshape(-1, 16, 16))
    capture = lm.simulate(truth, pairs)
    estimator = _Known(truth.transport())
    tested = report_facts.validate(capture, estimator)
    assert isinstance(tested, report_facts.Validation)
    assert tested.others == estimator.seen[0].count == 32 - 2 * len(tested.frames)
    seen = np.stack([estimator.seen[0].frame(k) for k in range(tested.others)])
    unseen = np.stack([capture.frame(int(k) ^ 1) for k in tested.frames])
    assert not any((seen == inverse).all(axis=(1, 2)).any() for inverse in unseen)


# ---- recommendations


def _facts(capture: lm.Capture, transport: lm.LightTransport, **more: Any) -> Facts:
    return Facts(transport, capture, None, more.get("validation", "the test was not requested"))


def test_each_problem_has_a_recommendation(
    capture: SimulatedCapture, estimate: lm.LightTransport
) -> None:
    def advice(transport: lm.LightTransport, of: lm.Capture = capture, **more: Any) -> str:
        return " ".join(recommendations(_facts(of, transport, **more)))

    rows = len(estimate.background)
    bounded = {**estimate.diagnostics, "only_bounded": np.ones(rows)}
    bright = replace(estimate, sparse=estimate.sparse * 3, diagnostics=bounded)
    assert "only a lower bound" in advice(bright)
    often = {"clipped_share": np.full(rows, 0.9, np.float32)}
    assert "more than half of their samples" in advice(replace(estimate, diagnostics=often))
    dim = lm.simulate(capture.truth, capture.patterns, exposure=0.05)
    assert "times as long" in advice(estimate, dim)
    tested = report_facts.validate(capture, _Known(estimate))
    assert isinstance(tested, report_facts.Validation)
    inaccurate = advice(estimate, validation=replace(tested, error=0.5))
    assert "unseen photographs: 50 %" in inaccurate
    assert "(80 instead of 40)" in inaccurate
    diffuse = replace(estimate, background=100 * np.maximum(estimate.background, 0.01))
    assert "is in the faint background" in advice(diffuse)


# ---- in a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if installed() is None:
        pytest.skip("no Chromium is installed: make system-deps brings one")
    with opened() as chromium:
        yield chromium


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (360, "dark")])
def test_the_page_is_accessible(width: int, scheme: Any, written: Path, browser: Browser) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.goto((written / "report.html").as_uri())
    result = Axe().run(page)
    assert not result.response["violations"], result.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


def test_the_page_requests_nothing_and_shows_its_pictures(written: Path, browser: Browser) -> None:
    page = browser.new_page(color_scheme="dark")
    requests: list[str] = []
    messages: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.on("console", lambda message: messages.append(message.text))
    page.goto((written / "report.html").as_uri())
    missing = "[...document.images].filter(i => !(i.complete && i.naturalWidth)).length"
    assert page.evaluate(missing) == 0
    assert [url for url in requests if not url.startswith(("file:", "data:"))] == []
    assert messages == []
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.emulate_media(color_scheme="light")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != dark
    # On paper the page is black on white, without the links of the navigation.
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
    assert not page.locator("nav").is_visible()
    assert page.pdf(format="A4").startswith(b"%PDF")
    page.close()
