"""The correspondence of camera and projector pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from tests.helpers.transports import COLS, ROWS, random_transport


@pytest.fixture
def transport() -> lm.LightTransport:
    return random_transport()


def test_correspondence_matches_its_definition(transport: lm.LightTransport) -> None:
    matches = lm.correspondence(transport)
    for index, row in enumerate(transport.sparse.toarray()):
        at = np.unravel_index(index, (5, 6))
        if not row.any():
            assert matches.pixel[at].tolist() == [-1, -1]
            assert np.isnan(matches.place[at]).all()
            assert matches.confidence[at] == 0
            continue
        image = row.reshape(ROWS, COLS)
        r, c = np.unravel_index(int(image.argmax()), image.shape)
        assert matches.pixel[at].tolist() == [r, c]
        near = np.zeros_like(image)
        window = slice(max(0, r - 2), r + 3), slice(max(0, c - 2), c + 3)
        near[window] = image[window]
        share = near.sum() / (row.sum() + transport.background[index].sum())
        assert matches.confidence[at] == pytest.approx(share, rel=1e-5)
        grid = np.indices(image.shape)
        centre = (grid * near).sum(axis=(1, 2)) / near.sum()
        np.testing.assert_allclose(matches.place[at], centre, rtol=1e-5)


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
    matches = lm.correspondence(colour)
    np.testing.assert_allclose(matches.confidence, whole.confidence, rtol=1e-5)
    np.testing.assert_array_equal(matches.pixel, whole.pixel)
