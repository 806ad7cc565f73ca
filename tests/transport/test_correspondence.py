"""Correspondence, the maps over the camera, and the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array

import lightmatrix as lm
from lightmatrix.evaluation.verdict import stated_error, verdict
from lightmatrix.pictures import maps

ROWS, COLS = 9, 7


@pytest.fixture
def transport() -> lm.LightTransport:
    """Random rows over a projector of 9 x 7, one of them dark, with a background."""
    generator = np.random.default_rng(3)
    sparse = random_array((30, ROWS * COLS), density=0.2, rng=generator, format="csr")
    dense = sparse.toarray().astype(np.float32)
    dense[4] = 0
    background = generator.random((30, 2)).astype(np.float32)
    return lm.LightTransport(csr_array(dense), background, (5, 6), (ROWS, COLS), (2, 1))


def test_correspondence_is_what_it_says(transport: lm.LightTransport) -> None:
    found = lm.correspondence(transport)
    for index, row in enumerate(transport.sparse.toarray()):
        at = np.unravel_index(index, (5, 6))
        if not row.any():
            assert found.pixel[at].tolist() == [-1, -1]
            assert np.isnan(found.place[at]).all()
            assert found.confidence[at] == 0
            continue
        image = row.reshape(ROWS, COLS)
        r, c = np.unravel_index(int(image.argmax()), image.shape)
        assert found.pixel[at].tolist() == [r, c]
        near = np.zeros_like(image)
        window = slice(max(0, r - 2), r + 3), slice(max(0, c - 2), c + 3)
        near[window] = image[window]
        share = near.sum() / (row.sum() + transport.background[index].sum())
        assert found.confidence[at] == pytest.approx(share, rel=1e-5)
        grid = np.indices(image.shape)
        centre = (grid * near).sum(axis=(1, 2)) / near.sum()
        np.testing.assert_allclose(found.place[at], centre, rtol=1e-5)


def test_chunks_and_channels_make_no_difference(
    transport: lm.LightTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = lm.correspondence(transport)
    monkeypatch.setattr("lightmatrix.transport.correspondence._ENTRIES", 20)
    np.testing.assert_array_equal(lm.correspondence(transport).place, whole.place)
    colour = replace(
        transport,
        sparse=csr_array(np.repeat(transport.sparse.toarray(), 3, axis=0)),
        background=np.repeat(transport.background, 3, axis=0),
        camera_shape=(5, 6, 3),
    )
    found = lm.correspondence(colour)
    np.testing.assert_allclose(found.confidence, whole.confidence, rtol=1e-5)
    np.testing.assert_array_equal(found.pixel, whole.pixel)


def test_levels_tell_dark_pixels_from_faint_ones(transport: lm.LightTransport) -> None:
    found = lm.correspondence(transport)
    levels = found.levels()
    assert levels.dtype == np.uint16
    np.testing.assert_array_equal(levels[..., 2] > 0, found.found)
    lit = found.found
    np.testing.assert_array_equal(levels[lit][:, :2], found.pixel[lit][:, ::-1])


def test_maps_are_read_without_colour(transport: lm.LightTransport) -> None:
    """Lightness grows or falls all the way, as on a copier or for who sees no colours."""
    found = lm.correspondence(transport)
    rows = np.arange(30, dtype=np.float32)
    knowing = replace(
        transport,
        diagnostics={
            "clipped_share": rows / 30, "gap": 1e-5 * rows, "footprint": rows,
            "estimated_error": rows / 30,
        },
    )  # fmt: skip
    shown = [
        maps.clipping_map(knowing), maps.gap_map(knowing), maps.footprint_map(knowing),
        maps.stated_error_map(knowing), maps.error_map(rows.reshape(5, 6)),
        *maps.correspondence_maps(found),
    ]  # fmt: skip
    for one in shown:
        colours = one.colour_map(np.linspace(0, 1, 64))[:, :3] ** 2.2
        steps = np.diff(colours @ (0.2126, 0.7152, 0.0722))
        assert (steps > 0).all() or (steps < 0).all(), one.name
        pixels = one.pixels()
        assert pixels.shape == (5, 6, 3)
        assert pixels.dtype == np.uint8
    # What is not known is told from the smallest value.
    assert (shown[5].pixels()[np.isnan(shown[5].values)] == 178).all()


def test_maps_of_unknown_facts_are_refused(transport: lm.LightTransport) -> None:
    for show in (lm.show_clipping, lm.show_gaps, lm.show_footprints, lm.show_stated_errors):
        with pytest.raises(lm.InputError, match="does not know"):
            show(transport)


def test_the_verdict_follows_what_rows_state(transport: lm.LightTransport) -> None:
    assert verdict(transport).level == "not tested"

    def judged(**facts: float) -> str:
        diagnostics = {name: np.full(30, value) for name, value in facts.items()}
        return str(verdict(replace(transport, diagnostics=diagnostics)))

    assert judged(estimated_error=0.01).startswith(
        "good: the rows state a relative error of T of 1 %"
    )
    assert judged(estimated_error=0.1).startswith("fair")
    assert judged(estimated_error=0.5).startswith("doubtful")
    assert "not tested: 100 % of the rows converged" in judged(converged=1)
    assert "reached the iteration limit" in judged(converged=0)
    assert "clipped in more than half" in judged(clipped_share=0.8, estimated_error=0.01)
    # Rows count by their light; those that state nothing do not.
    errors = np.where(np.arange(30) < 2, 0.5, 0.01)
    errors[5] = np.nan
    mixed = replace(transport, diagnostics={"estimated_error": errors})
    energy = (transport.dense_rows(np.arange(30)).astype(float) ** 2).sum(axis=1)
    known = np.isfinite(errors)
    expected = np.sqrt((energy[known] * errors[known] ** 2).sum() / energy[known].sum())
    assert stated_error(mixed) == pytest.approx(expected, rel=1e-5)
    assert verdict(mixed).level == "fair"


def test_an_estimate_that_did_not_see_its_brightest_light_is_not_called_good(
    transport: lm.LightTransport,
) -> None:
    brightest = float(transport.dense_rows(np.arange(30)).max())

    def judged(exposure: object) -> lm.Verdict:
        known = {"estimated_error": np.full(30, 0.01)}
        made = {"capture_description": {"exposure": exposure}}
        return verdict(replace(transport, diagnostics=known, provenance=made))

    assert judged(0.5 / brightest).level == "good"
    clipped = judged([1e3 / brightest, 2e3 / brightest])
    assert clipped.level == "fair"
    assert "of the rows clip under a single projector pixel" in clipped.sentence
    # The shortest of several exposures saw it.
    assert judged([1e3 / brightest, 0.5 / brightest]).level == "good"
    damaged: object
    for damaged in ("much", None, [], {}, float("nan"), ["a"]):
        assert judged(damaged).level == "good"
