"""What is looked at of a capture, and which rows of it vary enough."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import lightmatrix as lm
from lightmatrix.check import survey as surveys
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.patterns.bits import BernoulliPatterns

K = 12


def survey(frames: NDArray[np.uint8], decoder: lm.Decoder | None = None) -> Survey:
    capture = lm.Capture.from_arrays(
        BernoulliPatterns((4, 4), len(frames)),
        frames,
        decoder or lm.Decoder(clip=255, full_scale=255),
    )
    return Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)


def random_frames(*shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 255, (K, *shape)).astype(np.uint8)


def test_large_frames_are_looked_at_in_whole_blocks_of_jpeg(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(surveys, "_MOST_LEVELS", K * 6 * 32 * 32)
    frames = random_frames(100, 180)
    tiles = survey(frames)
    count, rows, cols, channels = tiles.grid
    assert (rows, cols, channels) == (32, 32, 1)
    assert 4 <= count <= 6
    place = np.arange(100 * 180).reshape(100, 180)
    raw = tiles.raw.reshape(count, 32, 32, K)
    corners = set()
    for tile in raw:
        (index,) = np.flatnonzero((tile[0, 0] == frames.reshape(K, -1).T).all(axis=1))
        row, col = divmod(int(index), 180)
        assert row % 8 == 0
        assert col % 8 == 0
        np.testing.assert_array_equal(
            tile.reshape(-1, K),
            frames.reshape(K, -1).T[place[row : row + 32, col : col + 32]].reshape(-1, K),
        )
        corners.add((row, col))
    assert len(corners) == count
    assert (0, 0) in corners
    assert max(row for row, _ in corners) == 64
    assert max(col for _, col in corners) == 144


def test_cropped_frames_keep_the_blocks_of_jpeg() -> None:
    frames = random_frames(60, 70)
    capture = lm.Capture.from_arrays(
        BernoulliPatterns((4, 4), K), frames, lm.Decoder(clip=255, full_scale=255)
    ).crop((3, 5), (50, 60))
    taken = Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask)
    assert taken.grid == (1, 45, 57, 1)
    np.testing.assert_array_equal(taken.raw[0], frames[:, 8, 8])


def test_masked_hot_and_dark_samples_do_not_count() -> None:
    frames = random_frames(10, 10)
    mask = np.ones((10, 10), bool)
    mask[2, 3] = False
    black = np.arange(100, dtype=np.float32)
    black[7] = 255
    decoder = lm.Decoder(clip=255, full_scale=255, black_frame=black)
    capture = lm.Capture.from_arrays(BernoulliPatterns((4, 4), K), frames, decoder)
    taken = Survey.take(capture.patterns, capture.frames, decoder, mask)
    assert np.flatnonzero(~taken.valid).tolist() == [7, 23]
    np.testing.assert_allclose(
        taken.samples(np.array([50, 4])).values,
        np.stack([frames[:, 5, 0] - 50.0, frames[:, 0, 4] - 4.0]) / 255,
        atol=0.01,
    )


# ---- rows of high variance


def test_rows_vary_much_and_clip_little() -> None:
    frames = random_frames(30, 30)
    rows = high_variance_rows(survey(frames))
    assert len(rows) == 22 * 22
    assert (np.diff(rows) > 0).all()
    spread = frames.std(axis=0).max()
    frames[:, 10] = 100 + 0.1 * (frames[:, 10] - 100.0)
    frames[:, 11] = 100 + 0.25 * (frames[:, 11] - 100.0)
    chosen = high_variance_rows(survey(frames)) // 30
    assert 10 not in chosen
    assert 11 in chosen
    assert spread > 50
