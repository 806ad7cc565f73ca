"""As many photographs as it takes: when a capture stops, and what it says about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.errors import InputError
from lightmatrix.rig.capturing import FIRST, GROUP, parse_until, photograph_until
from lightmatrix.rig.session import CaptureSession

from .faulty_rig import USUAL, faulty_rig

RIG = "virtual:procedural,size=32,real=0"


def estimate_of(
    error: float, clipped: float = 0.0, spread: bool = False, constant: float = 0.0
) -> lm.LightTransport:
    """Nine rows with an error each, on single pixels or spread over all."""
    matrix = np.full((9, 36), 1 / 36) if spread else np.eye(9, 36)
    facts = {
        "estimated_error": np.full(9, error, np.float32),
        "prediction_error": np.full(9, 10 * error, np.float32),
        "constant_light": np.full(9, constant, np.float32),
        "clipped_share": np.full(9, clipped, np.float32),
    }
    return lm.LightTransport(
        csr_array(matrix.astype(np.float32)),
        np.zeros((9, 1), np.float32),
        (3, 3),
        (6, 6),
        diagnostics=facts,
    )


@dataclass
class Photographed:
    """A session that photographs nothing; frame `lost` is never to be had."""

    total: int
    lost: int | None = None
    counts: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.patterns = SimpleNamespace(count=self.total)
        self.record = SimpleNamespace(state=SimpleNamespace(frames={}))

    def run(self, count: int) -> None:
        self.counts.append(count)
        self.record.state.frames = {k: None for k in range(count) if k != self.lost}


def outcome(session: Photographed, target: float | str, *errors: float, **kind: Any) -> Any:
    """What is said if the estimates have these errors; the last one stays."""
    left = [*errors]
    return photograph_until(
        cast(CaptureSession, session),
        parse_until(target),
        lambda: estimate_of(left.pop(0) if len(left) > 1 else left[0], **kind),
    )


def test_it_stops_at_the_first_group_that_is_good_enough() -> None:
    session = Photographed(256)
    result = outcome(session, 0.03, 0.5, 0.2, 0.029, 0.001)
    assert session.counts == [FIRST, FIRST + GROUP, FIRST + 2 * GROUP]
    assert result.reached
    assert [frames for frames, _ in result.errors] == session.counts
    assert "2.9 % after 32 frames" in result.sentence


def test_a_session_that_goes_on_starts_with_its_frames() -> None:
    session = Photographed(256)
    session.record.state.frames = dict.fromkeys(range(37))
    outcome(session, 0.03, 0.02)
    assert session.counts == [40]


def test_it_ends_with_the_patterns() -> None:
    session = Photographed(30)
    result = outcome(session, 0.03, 0.5)
    assert session.counts == [16, 24, 30]
    assert not result.reached
    assert "all 30 patterns" in result.sentence


@pytest.mark.parametrize(
    ("kind", "advice"),
    [
        ({}, "expose for longer"),
        ({"clipped": 0.8}, "lower the exposure"),
        ({"spread": True}, "coarse cells"),
    ],
)
def test_where_more_patterns_do_not_help_it_says_what_would(
    kind: dict[str, Any], advice: str
) -> None:
    result = outcome(Photographed(256), 0.03, 0.1, **kind)
    # Errors may fall late, so the first 64 patterns are always photographed.
    assert result.errors[-1][0] == 64
    assert not result.reached
    assert "do not help" in result.sentence
    assert advice in result.sentence


def test_a_rig_stops_with_the_fewest_frames_that_do(tmp_path: Path) -> None:
    with faulty_rig(RIG + USUAL) as rig:
        settings = lm.CaptureSettings(until=0.065)
        capture = lm.take_capture(tmp_path / "c", rig, count=64, keep=None, settings=settings)
    truth = lm.truth(tmp_path / "c" / "truth.npz")
    sizes = range(8, capture.count + 1, 8)
    captures = [capture.select(np.arange(size)) for size in sizes]
    errors = [
        lm.evaluate(lm.estimate(each, check=False), truth).relative_error for each in captures
    ]
    enough = next(size for size, error in zip(sizes, errors, strict=True) if error <= 0.065)
    assert abs(capture.count - enough) <= 8
    assert capture.provenance["until"]["reached"]
    assert capture.provenance["until"]["errors"][-1][0] == capture.count


def test_relit_images_may_be_the_target() -> None:
    # Here photographs are predicted ten times worse than T is estimated.
    result = outcome(Photographed(256), "relighting:0.03", 0.02, 0.0025)
    assert result.reached
    assert result.relighting
    assert result.errors == [(16, pytest.approx(0.2)), (24, pytest.approx(0.025))]


def test_an_error_that_the_verdict_does_not_state_reaches_nothing() -> None:
    result = outcome(Photographed(256), 0.03, 0.01, constant=0.5)
    assert not result.reached
    assert result.errors[-1][0] == 64
    assert "no error can be stated" in result.sentence
    assert "black frame" in result.sentence


@pytest.mark.parametrize("target", [0, 1.5, float("nan"), "relighting", "T:0.03", "relighting:2"])
def test_impossible_targets_are_refused(target: float | str) -> None:
    with pytest.raises(InputError, match=r"such as 0\.03"):
        lm.CaptureSettings(until=target)
