"""The likeliest hypothesis is the true one, and reading at another exposure is exact."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lightmatrix.diagnosis.frame_order import (
    Hypothesis,
    RawRows,
    _hypotheses,
    _log_misses,
    _mixtures,
    _scan,
    explained,
    find_misses,
    likeliest_hypothesis,
    normalized_columns,
)
from lightmatrix.diagnosis.pursuit import column_scale
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.patterns.pattern_set import ImagePatterns
from tests.helpers.surface import PROJECTOR, surface

K = 48
PATTERNS = BernoulliPatterns(PROJECTOR, K)
FRAMES = np.arange(K)


def rows(
    order: NDArray[np.integer] = FRAMES,
    exposure: NDArray[np.floating] | None = None,
    exposed_as: NDArray[np.integer] = FRAMES,
) -> RawRows:
    """Every fourth row of the surface, whose frames show `order`, exposed like `exposed_as`."""
    exposure = np.ones(K) if exposure is None else exposure
    light = PATTERNS.forward(surface())[::4][:, order]
    level = np.broadcast_to(3 / exposure, light.shape).astype(np.float32)
    shares = np.minimum(light * exposure[exposed_as] / 3, 1)
    return RawRows(shares.astype(np.float32), level)


def displaced(step: int, first: int, last: int) -> NDArray[np.int64]:
    order = FRAMES.copy()
    order[first:last] += step
    return order.clip(0, K - 1)


def test_samples_read_at_another_exposure() -> None:
    shares = np.array([[0.5, 1.0, 0.25]], np.float32)
    raw = RawRows(shares, np.array([[1.0, 2.0, 4.0]], np.float32))
    assert raw.lowest.tolist() == [[1.0]]
    np.testing.assert_allclose(raw.light(np.arange(3)), [[0.5, 1, 1]])
    np.testing.assert_allclose(raw.light(np.array([1, 0, 0])), [[1, 1, 0.25]])
    assert [group.tolist() for group in raw.exposure_groups()] == [[0], [1], [2]]
    equal = RawRows(shares, np.array([[1.0, 2.0, 1.001]], np.float32))
    assert [group.tolist() for group in equal.exposure_groups()] == [[0, 2], [1]]


def test_frames_in_order_need_no_hypothesis() -> None:
    assert likeliest_hypothesis(PATTERNS, rows()) is None
    in_order = Hypothesis.in_order(K)
    assert not in_order.reversed
    assert Hypothesis(FRAMES[::-1], FRAMES).reversed


@pytest.mark.parametrize(
    "order",
    [
        displaced(1, 24, K),
        displaced(1, 0, 12),
        displaced(-1, 36, K),
        displaced(-1, 0, 24),
        displaced(1, 0, K),
        FRAMES[::-1],
    ],
    ids=["after", "after, up to one", "before", "before, up to one", "all", "backwards"],
)
def test_the_likeliest_hypothesis_is_the_true_one(order: NDArray[np.int64]) -> None:
    best = likeliest_hypothesis(PATTERNS, rows(order))
    assert best is not None
    known = best.order >= 0
    assert (best.order == order)[known].mean() > 0.97
    assert known.sum() >= K - 1
    np.testing.assert_array_equal(best.exposed_as, FRAMES)


@pytest.mark.parametrize("renamed", [True, False])
def test_exposures_go_with_the_files_or_stay(renamed: bool) -> None:
    exposure = np.tile([4.0, 1.0, 4.0, 0.5], K // 4)
    order = displaced(1, 0, K)
    best = likeliest_hypothesis(PATTERNS, rows(order, exposure, order if renamed else FRAMES))
    assert best is not None
    np.testing.assert_array_equal(best.order[:-1], order[:-1])
    assert (best.exposed_as[:-1] == (order if renamed else FRAMES)[:-1]).all()


def test_misses_are_those_of_the_other_pattern() -> None:
    scale = column_scale(PATTERNS)
    order = FRAMES.copy()
    order[[4, 9]] = 9, 4
    misses = find_misses(PATTERNS, rows(order), Hypothesis.in_order(K), scale)
    assert misses.logarithms.shape == (K, K)
    assert misses.logarithms[4].argmin() == 9
    assert misses.logarithms[9].argmin() == 4
    usual = np.delete(misses.own, [4, 9])
    assert np.median(usual) < -1
    assert misses.own[[4, 9]].min() > 0
    assert misses.informative.all()
    assert not misses.elsewhere.any()
    # As it is, once it is known which frame shows which pattern; or that one is unknown.
    right = find_misses(PATTERNS, rows(order), Hypothesis(order, FRAMES), scale)
    assert right.logarithms[FRAMES, order].max() < 0
    unknown = np.where(order == FRAMES, FRAMES, -1)
    without = find_misses(PATTERNS, rows(order), Hypothesis(unknown, FRAMES), scale)
    assert without.logarithms[FRAMES, order].max() < 0


def test_misses_do_not_depend_on_brightness() -> None:
    scale, in_order = column_scale(PATTERNS), Hypothesis.in_order(K)
    plain = rows()
    before = find_misses(PATTERNS, plain, in_order, scale)
    brighter = plain.shares + 0.05 * np.sin(FRAMES)
    after = find_misses(
        PATTERNS, RawRows(brighter.astype(np.float32), plain.levels), in_order, scale
    )
    assert after.own.max() < -2
    assert np.median(after.own) < np.median(before.own) + 0.1


def test_a_frame_taken_with_the_exposure_of_another_is_recognised() -> None:
    exposure = np.where(FRAMES % 4 == 3, 0.5, 1.0)
    order = FRAMES.copy()
    order[[4, 11]] = 11, 4
    misses = find_misses(
        PATTERNS, rows(order, exposure, order), Hypothesis.in_order(K), column_scale(PATTERNS)
    )
    assert misses.elsewhere[4, 11]
    assert not np.diag(misses.elsewhere).any()


def test_uniform_patterns_tell_nothing() -> None:
    images = PATTERNS.images().copy()
    images[5] = 0.5
    grey = ImagePatterns(images)
    light = (grey.forward(surface())[::4] / 10).astype(np.float32)
    raw = RawRows(light, np.full(light.shape, 10, np.float32))
    misses = find_misses(grey, raw, Hypothesis.in_order(K), column_scale(grey))
    assert np.flatnonzero(~misses.informative).tolist() == [5]


def test_normalized_columns() -> None:
    columns = normalized_columns(PATTERNS, 7, 19)
    np.testing.assert_allclose(columns.mean(axis=0), 0, atol=1e-6)
    np.testing.assert_allclose((columns**2).sum(axis=0), 1, rtol=1e-5)
    images = PATTERNS.images().copy()
    images[:, 0, 0] = 0.5
    assert not normalized_columns(ImagePatterns(images), 0, 1).any()


def test_explained() -> None:
    assert explained(np.array([[0.5, 0.75]])) == pytest.approx(1.5 * np.log(2))
    assert np.isfinite(explained(np.ones((1, 2)))).all()


def test_mixtures_are_displaced_from_or_up_to_each_part() -> None:
    generator = np.random.default_rng(0)
    plain, displaced = ([generator.random(3, np.float32) for _ in range(4)] for _ in range(2))
    changes = [own - other for own, other in zip(plain, displaced, strict=True)]
    mixed = _mixtures(np.sum(plain, axis=0), np.sum(displaced, axis=0), changes)
    sums = np.array([total.copy() for total in mixed])
    expected = [np.sum(displaced, axis=0)]
    for k in range(1, 5):
        expected.append(np.sum(plain[:k] + displaced[k:], axis=0))
        expected.append(np.sum(displaced[:k] + plain[k:], axis=0))
    np.testing.assert_allclose(sums, np.array(expected), atol=1e-5)


def test_orders_that_are_tried() -> None:
    orders = [list(range(4)), [1, 2, 3, -1], [-1, 0, 1, 2], [3, 2, 1, 0]]
    one = _hypotheses(4, False)
    assert [each.order.tolist() for each in one] == orders
    assert all(each.exposed_as.tolist() == [0, 1, 2, 3] for each in one)
    # With several exposures also those that go with the files; unknown frames keep their own.
    several = _hypotheses(4, True)
    assert [each.order.tolist() for each in several[1::2]] == orders[1:]
    assert [each.order.tolist() for each in several[2::2]] == orders[1:]
    exposed = [[1, 2, 3, 3], [0, 0, 1, 2], [3, 2, 1, 0]]
    assert [each.exposed_as.tolist() for each in several[2::2]] == exposed


def test_logarithms_of_misses_follow_their_definition() -> None:
    generator = np.random.default_rng(0)
    observed, expected = generator.standard_normal((9, 4)), generator.standard_normal((9, 3))
    observed[:, 2] = expected[:, 1]
    misses = _log_misses(observed, expected)
    for k, j in np.ndindex(4, 3):
        square = ((observed[:, k] - expected[:, j]) ** 2).sum() / (observed[:, k] ** 2).sum()
        assert misses[k, j] == pytest.approx(np.log(max(square, 1e-10)), abs=0.01) or square < 1e-9
    assert misses[2, 1] < -15
    assert np.isfinite(_log_misses(0 * observed, expected)).all()


def test_places_are_scored_by_the_pixels_that_follow_the_rows() -> None:
    """The explained share is that of the best single pixel, at the place of the change."""
    count = 32
    patterns = BernoulliPatterns((4, 5), count, seed=2)
    frames = np.arange(count)
    shown = normalized_columns(patterns, 0, 20)
    late = np.append(frames[1:], -1)
    # Three rows see one pixel each; from frame 16 on, each frame shows the next pattern.
    order = np.where(frames < 16, frames, late)
    light = (shown[order][:, [3, 9, 17]].T * (order >= 0)).astype(np.float32)
    hypotheses = _hypotheses(count, False)
    values = [np.where(each.order >= 0, light, 0).astype(np.float32) for each in hypotheses]
    parts = [(start, start + 8) for start in range(0, count, 8)]
    scores = _scan(patterns, hypotheses, values, parts)
    # Places are: all displaced, displaced from part 1 on, up to it, from part 2 on, up to it, ...
    assert [len(each) for each in scores] == [1, 9, 9, 1]
    assert int(scores[1].argmax()) == 3
    assert scores[1].max() > 2 * max(scores[0].max(), scores[2].max(), scores[3].max())
    for each, value, score in zip(hypotheses, values, scores, strict=True):
        for place, found in enumerate(score):
            cut = 8 * ((place + 1) // 2)
            displaced = (frames < cut) == (place % 2 == 0) if place else np.ones(count, bool)
            mixed = np.where(displaced, value, values[0])
            best = (mixed @ shown[np.where(displaced, each.order, frames)]).max(axis=1)
            share = np.maximum(best, 0) ** 2 / (mixed**2).sum(axis=1)
            assert found == pytest.approx(explained(share), rel=1e-3, abs=1e-4)
