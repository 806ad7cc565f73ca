"""The verdicts on an estimate, and the faults at which no error of T is stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from benchmarks import synthetic_captures
from benchmarks.synthetic_captures import draw
from lightmatrix.judgement.judgement import Level, OwnError, Verdict, verdicts
from lightmatrix.judgement.metrics import relative_error, relighting_error
from lightmatrix.simulation.procedural import ProceduralScene
from tests.helpers.transports import random_transport

SIZE = (16, 16)


@pytest.fixture
def transport() -> lm.LightTransport:
    return random_transport()


def test_the_verdict_follows_the_estimated_errors(transport: lm.LightTransport) -> None:
    assert verdicts(transport).transport.level == "not tested"

    def judged(**facts: float) -> str:
        diagnostics = {name: np.full(30, value) for name, value in facts.items()}
        return str(verdicts(replace(transport, diagnostics=diagnostics)).transport)

    assert judged(estimated_error=0.01).startswith("Good. Estimated error of T: 1 %.")
    assert judged(estimated_error=0.1).startswith("Fair. ")
    assert judged(estimated_error=0.5).startswith("Doubtful. ")
    assert "Not tested. 100 % of the rows converged." in judged(converged=1)
    assert "reached the iteration limit" in judged(converged=0)
    assert "clipped in more than half" in judged(clipped_share=0.8, estimated_error=0.01)
    # Rows count by their light; rows without an estimated error do not count.
    errors = np.where(np.arange(30) < 2, 0.5, 0.01)
    errors[5] = np.nan
    mixed = replace(transport, diagnostics={"estimated_error": errors})
    energy = (transport.to_matrix(dense_background=True).toarray().astype(float) ** 2).sum(axis=1)
    known = np.isfinite(errors)
    expected = np.sqrt((energy[known] * errors[known] ** 2).sum() / energy[known].sum())
    assert OwnError(mixed).estimated == pytest.approx(expected, rel=1e-5)
    assert verdicts(mixed).transport.level == "fair"


def test_what_no_error_estimate_shows_makes_the_verdict_doubtful() -> None:
    good = Verdict("good", 0.01)
    assert good.sentence == "Estimated error of T: 1 %."
    assert good.with_findings(["gain", "stripes"]) is good
    spoiled = good.with_findings(["camera-curve", "gain", "order"])
    assert spoiled.level == "doubtful"
    assert spoiled.sentence.endswith("(camera-curve, order).")
    assert spoiled.error is None


def test_rows_that_clip_singly_count_by_their_light(transport: lm.LightTransport) -> None:
    light = transport.to_matrix(dense_background=True).toarray()
    brightest = light.max(axis=1)
    order = np.argsort(-brightest)
    shares = np.cumsum((light**2).sum(axis=1)[order]) / (light**2).sum()

    def judged(exposure: object) -> Verdict:
        known = {"estimated_error": np.full(30, 0.01)}
        made = {"capture_description": {"exposure": exposure}}
        return verdicts(replace(transport, diagnostics=known, provenance=made)).transport

    assert judged(0.5 / brightest.max()).level == "good"
    levels = {}
    for share in (0.2, 0.8):
        # At this exposure, rows of just that share of the squared light clip, or of a little more.
        clipped = judged([1e3, float(1 / brightest[order[np.searchsorted(shares, share)]])])
        levels[share] = clipped.level
        assert "of the squared light is in rows that clip" in clipped.sentence
    assert levels == {0.2: "fair", 0.8: "doubtful"}
    # The shortest of several exposures does not clip.
    assert judged([1e3 / brightest.max(), 0.5 / brightest.max()]).level == "good"
    damaged: object
    for damaged in ("much", None, [], {}, float("nan"), ["a"]):
        assert judged(damaged).level == "good"


@pytest.mark.parametrize(("damage", "level"), [("intact", "good"), ("overexposed", "doubtful")])
def test_photographs_that_clip_do_not_test_linear_images(damage: str, level: str) -> None:
    case = draw("wall", "random", damage, 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    images = np.random.default_rng(0).integers(0, 2, (4, 16, 16)).astype(np.float32)
    wrong = relighting_error([estimate], [case.truth], images)
    judged = verdicts(estimate).relighting
    assert judged.level == level
    assert judged.error is not None
    assert judged.error < 0.05
    assert (wrong > 0.1) == (level != "good")


def _gray() -> lm.ImagePatterns:
    """8 patterns of Gray code: 4 bits of the row, 4 of the column."""
    code = np.arange(16) ^ (np.arange(16) >> 1)
    bits = np.stack([code >> k & 1 for k in range(4)]).astype(np.float32)
    along = np.ones(16, np.float32)
    return lm.ImagePatterns(
        np.concatenate([bits[:, :, None] * along, bits[:, None] * along[:, None]])
    )


def _random(count: int, *, tiled: bool = False) -> lm.ImagePatterns:
    values = (np.random.default_rng(0).random((count, *SIZE)) < 0.5).astype(np.float32)
    if tiled:
        values[:, :, 8:] = values[:, :, :8]
    return lm.ImagePatterns(values)


def _judged(patterns: lm.PatternSet) -> tuple[lm.LightTransport, lm.Verdicts]:
    truth = ProceduralScene(SIZE, SIZE, background=0).truth()
    capture = lm.simulate(truth, patterns, exposure=0.5, seed=0)
    estimate = lm.estimate(capture)
    return estimate, lm.verdicts(estimate)


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_stripes_have_a_correspondence_and_nothing_else() -> None:
    estimate, judged = _judged(_gray())
    assert judged.transport.level == judged.relighting.level == "not tested"
    assert judged.correspondence.level == "good", judged.correspondence
    assert set(estimate.diagnostics["certain"]) <= {0, 1}


@pytest.mark.filterwarnings("ignore::lightmatrix.errors.LightMatrixWarning")
def test_an_ambiguous_code_relights_and_has_no_correspondence(tmp_path: Path) -> None:
    estimate, judged = _judged(_random(48, tiled=True))
    assert judged.relighting.level == "good"
    assert judged.correspondence.level == "doubtful"
    # The store knows what was found in the capture.
    assert judged.transport.level == "doubtful"
    assert "patterns" in judged.transport.sentence
    lm.save(tmp_path / "scene.zarr", estimate)
    assert lm.verdicts(lm.open(tmp_path / "scene.zarr")).transport == judged.transport


def test_random_patterns_have_all_three() -> None:
    _, judged = _judged(_random(48))
    levels = {name: each["verdict"] for name, each in judged.as_dict().items()}
    assert set(levels) == {"correspondence", "relighting", "transport"}
    assert levels["correspondence"] == levels["relighting"] == "good"
    assert levels["transport"] != "not tested"
    assert lm.Verdicts.from_dict(judged.as_dict()) == judged
    assert judged.lines()[0] == f"T: {judged.transport}"


@pytest.mark.parametrize(
    ("share", "level"), [(1, "good"), (0.9, "fair"), (0.5, "doubtful"), (np.nan, "not tested")]
)
def test_the_share_of_certain_pixels_decides(share: float, level: Level) -> None:
    transport = random_transport()
    certain = np.where(np.arange(30) < 30 * share, 1.0, 0.0)
    if np.isnan(share):
        certain[:] = np.nan
    judged = lm.verdicts(replace(transport, diagnostics={"certain": certain}))
    assert judged.correspondence.level == level


def test_findings_that_spoil_all_photographs_alike_leave_only_doubt() -> None:
    found: object
    diagnostics = {"certain": np.ones(30), "prediction_error": np.full(30, 0.01)}
    transport = replace(random_transport(), diagnostics=diagnostics)
    assert lm.verdicts(transport).relighting.level == "good"
    moved = replace(transport, provenance={"findings": [{"kind": "motion"}]})
    judged = lm.verdicts(moved)
    assert judged.relighting.level == judged.correspondence.level == "doubtful"
    # The provenance of a store may hold anything.
    for found in ("motion", 3, [3], [{"kind": []}], {"kind": "motion"}):
        odd = replace(transport, provenance={"findings": found})
        assert lm.verdicts(odd).relighting.level == "good"


@pytest.mark.parametrize(
    ("scene", "patterns", "damage", "reason"),
    [
        ("gripper", "few", "leak", "does not follow the patterns"),
        ("metal", "hadamard", "pedestal", "does not follow the patterns"),
        ("metal", "random", "curve", "linear in light"),
        ("glints", "shown twice", "intact", "in most photographs"),
        ("fibres", "shown twice", "overexposed", "shorter exposure"),
        ("metal", "with inverses", "overexposed", "shorter exposure"),
    ],
)
def test_no_error_is_stated_where_it_cannot_be_known(
    scene: str, patterns: str, damage: str, reason: str
) -> None:
    case = draw(scene, patterns, damage, 16, 5)
    estimate = lm.estimate(case.capture, check=False, correct="none")
    error = OwnError(estimate).estimated
    assert error is not None
    assert relative_error(estimate, case.truth) > max(0.05, 1.2 * error)
    assert OwnError(estimate).stated is None
    judged = verdicts(estimate).transport
    assert judged.level == "doubtful"
    assert reason in judged.sentence


@pytest.mark.parametrize(
    ("scene", "patterns", "size"),
    [
        ("gripper", "random", 16),
        ("l_objects", "few", 16),
        pytest.param("corner", "few", 16, marks=pytest.mark.slow),
        ("metal", "random", 16),
        ("textured", "hadamard", 16),
        ("half lit", "shown twice", 16),
        # What smooth patterns cannot tell apart, photographs under smooth patterns do not show.
        ("textured", "grey", 32),
    ],
)
def test_intact_captures_state_about_the_true_error(scene: str, patterns: str, size: int) -> None:
    case = draw(scene, patterns, "intact", size, 5)
    estimate = lm.estimate(case.capture, check=False)
    assert OwnError(estimate).doubts == []
    stated, true = OwnError(estimate).stated, relative_error(estimate, case.truth)
    assert stated is not None
    assert true / 2 < stated < 2 * true
    assert verdicts(estimate).transport.level in ("good", "fair")


@pytest.mark.parametrize(
    ("scene", "patterns", "damage"),
    [
        # All patterns show a pixel and its twin in the other half alike.
        ("wall", "tiled", "intact"),
        # The right half of the projector is never lit.
        ("wall", "half dark", "intact"),
        # Two glints hold most of the light, and clip.
        ("glints", "random", "intact"),
        ("wall", "random", "overexposed"),
        ("gripper", "random", "overexposed"),
        ("wall", "random", "leak"),
        # Each camera pixel sees a line of the projector, and most samples clip.
        ("columns", "few", "overexposed"),
    ],
)
def test_a_wrong_estimate_is_doubtful(
    scene: str, patterns: str, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(synthetic_captures.PATTERNS, "half dark", _half_dark)
    case = draw(scene, patterns, damage, 16, 5)
    kinds = {finding.kind for finding in lm.check(case.capture)}
    estimate = lm.estimate(case.capture, check=False)
    assert relative_error(estimate, case.truth) > 0.25
    assert verdicts(estimate).transport.with_findings(kinds).level == "doubtful"


def _half_dark(size: int, generator: np.random.Generator) -> synthetic_captures.Floats:
    images = generator.integers(0, 2, (64, size, size)).astype(np.float32)
    images[:, :, size // 2 :] = 0
    return images


def test_pixels_one_by_one_are_not_tested() -> None:
    case = draw("wall", "one pixel", "intact", 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    assert relative_error(estimate, case.truth) < 0.05
    assert verdicts(estimate).transport.level == "not tested"


def test_rows_that_are_only_bounded_raise_the_stated_error() -> None:
    case = draw("gripper", "few", "intact", 16, 5)
    estimate = lm.estimate(case.capture, check=False)
    before = OwnError(estimate).stated
    light = np.asarray(estimate.sparse.sum(axis=1)).ravel()
    bounded = light > np.quantile(light, 0.9)
    changed = replace(estimate, diagnostics={**estimate.diagnostics, "only_bounded": bounded * 1.0})
    after = OwnError(changed).stated
    assert before is not None
    assert after is not None
    assert after > 2 * before


@pytest.mark.parametrize(("seed", "exposure", "least"), [(0, 1.8, 0.4), (1, 1.6, 0.6)])
def test_a_scene_exposed_too_long_states_most_of_its_error(
    seed: int, exposure: float, least: float
) -> None:
    """A row that clips is found to be just as bright as the clip level, never above it."""
    truth = ProceduralScene((32, 32), (32, 32), seed=seed).truth()
    patterns = lm.BernoulliPatterns((32, 32), 32)
    capture = lm.simulate(truth, patterns, exposure=exposure, noise=0.003)
    estimate = lm.estimate(capture, check=False, correct="none")
    stated = OwnError(estimate).stated
    assert stated is not None
    assert least * relative_error(estimate, truth.transport()) < stated < 0.3
