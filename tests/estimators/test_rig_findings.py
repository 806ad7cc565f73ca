"""`check` names what the rig did, by an estimate of T, and leaves intact captures alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks.synthetic_captures import draw
from lightmatrix.check.finding import KINDS
from lightmatrix.estimators.rig_findings import rig_findings
from lightmatrix.rig_model.terms import TERMS
from tests.helpers.surface import PROJECTOR, photographs

K = 32
PATTERNS = lm.BernoulliPatterns(PROJECTOR, K)
LEVELS = photographs(PATTERNS, noise=0.001) / 255
GREY = np.rint(255 * np.random.default_rng(3).random((K, *PROJECTOR))) / 255
DECODER = lm.Decoder(clip=255, full_scale=255)


def captured(levels: np.ndarray, patterns: lm.PatternSet = PATTERNS) -> lm.Capture:
    return lm.Capture.from_arrays(patterns, np.rint(255 * levels).astype(np.uint8), DECODER)


def grey_capture(camera: float, projector: float) -> lm.Capture:
    """Photographs of grey patterns by a camera and a projector of these gammas."""
    light = photographs(lm.ImagePatterns((GREY**projector).astype(np.float32)), noise=0.001) / 255
    return captured(light ** (1 / camera), lm.ImagePatterns(GREY.astype(np.float32)))


def kinds(capture: lm.Capture) -> list[str]:
    return [each.kind for each in lm.check(capture)]


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_the_gamma_of_a_device_is_named(device: str) -> None:
    gamma = 0.6 if device == "camera" else 1.4
    seen = captured(LEVELS ** (1 / gamma)) if device == "camera" else grey_capture(1.0, gamma)
    (finding,) = lm.check(seen)
    assert finding.kind == f"{device}-curve"
    assert float(finding.message.split("gamma of ")[1].split()[0]) == pytest.approx(gamma, rel=0.1)
    assert ('response="auto"' in finding.advice) or device == "projector"


def test_the_gamma_of_the_camera_is_told_from_that_of_the_projector() -> None:
    assert kinds(grey_capture(2.2, 1.0)) == ["camera-curve"]


def test_curves_that_are_to_be_found_are_no_fault() -> None:
    unknown = replace(captured(LEVELS ** (1 / 2.2)), decoder=replace(
        DECODER, response=replace(lm.Response(), name="auto")))  # fmt: skip
    assert kinds(unknown) == []
    assert kinds(replace(grey_capture(1.0, 2.2), projector_unknown=True)) == []


@pytest.mark.parametrize(
    ("scene", "patterns", "seed"),
    [
        ("broad", "few", 1),
        ("permutation", "shown four times", 31011),
        ("wall", "grey", 0),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("speckle", "random", 0), ("diffuse", "mixed", 5), ("broad", "stripes", 5))
        ),
    ],
)
def test_light_that_is_hard_to_explain_is_no_fault(scene: str, patterns: str, seed: int) -> None:
    assert rig_findings(draw(scene, patterns, "intact", 32, seed).capture) == []


def test_intact_captures_are_left_alone() -> None:
    assert kinds(captured(LEVELS)) == kinds(grey_capture(1.0, 1.0)) == []
    assert kinds(captured(LEVELS).bin(projector=2)) == []


def test_photographs_that_show_something_else_tell_nothing_of_the_rig() -> None:
    bent = captured(LEVELS ** (1 / 2.2))
    order = lm.check(captured(np.roll(LEVELS, 1, axis=0) ** (1 / 2.2)))
    assert [each.kind for each in order] == ["order"]
    assert [each.kind for each in rig_findings(bent)] == ["camera-curve"]
    assert rig_findings(bent, order) == rig_findings(bent.select(np.arange(11))) == []


def test_every_term_has_a_kind_and_advice() -> None:
    assert {term.label or name for name, term in TERMS.items()} <= set(KINDS)
    assert all(term.advice for term in TERMS.values())


@pytest.mark.parametrize("settings", [{"correct": "none"}, {"coherent": False, "iterations": 2}])
def test_what_is_not_corrected_is_named_and_spoils_the_verdict(settings: dict[str, object]) -> None:
    with pytest.warns(lm.LightMatrixWarning, match="camera-curve: ") as caught:
        transport = lm.estimate(captured(LEVELS ** (1 / 2.2)), progress=False, **settings)  # type: ignore[arg-type]
    assert len([each for each in caught if "camera-curve" in str(each.message)]) == 1
    assert [each["kind"] for each in transport.provenance["findings"]] == ["camera-curve"]
    assert lm.verdicts(transport).transport.level in ("doubtful", "not tested")
