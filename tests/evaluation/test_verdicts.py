"""Correspondence, relighting and T are judged apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.evaluation.verdict import Level
from lightmatrix.simulation.procedural_scene import ProceduralScene
from tests.helpers.transports import random_transport

SIZE = (16, 16)


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


@pytest.mark.filterwarnings("ignore:all patterns are stripes")
def test_stripes_have_a_correspondence_and_nothing_else() -> None:
    estimate, judged = _judged(_gray())
    assert judged.transport.level == judged.relighting.level == "not tested"
    assert judged.correspondence.level == "good", judged.correspondence
    assert set(estimate.diagnostics["certain"]) <= {0, 1}


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
