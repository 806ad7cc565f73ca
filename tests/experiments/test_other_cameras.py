"""Other views of a scene, and statistics of a known matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lightmatrix as lm
from experiments.fig5 import clipped_share, direct_share, entries_for_energy
from experiments.other_cameras import mapped, seen, varying_defocus
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.realism import defocus
from lightmatrix.simulation.truth import Truth

SIDE = 64


def test_views_show_the_same_rows(tmp_path: Path) -> None:
    truth = lm.truth("metal")
    turned = seen(truth, mapped((SIDE, SIDE), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])))
    assert turned.camera_shape == (SIDE, SIDE)
    white = np.ones(truth.projector_shape)
    straight = truth.transport().relight(white)
    np.testing.assert_allclose(turned.transport().relight(white), np.rot90(straight), rtol=1e-6)
    beyond = seen(truth, np.array([[-1, 5]]))
    assert not beyond.transport().relight(white)[0, 0]
    np.testing.assert_allclose(
        np.asarray(beyond.direct.sum(axis=1)).ravel()[1],
        np.asarray(truth.direct.sum(axis=1)).ravel()[5],
    )
    # A view can be saved, although nobody knows the geometry of its camera.
    beyond.save(tmp_path / "T.npz")
    assert lm.truth(tmp_path / "T.npz").camera_shape == (1, 2)


def test_a_view_of_a_colour_camera_is_refused() -> None:
    truth = lm.truth("metal")
    colour = Truth(truth.matrix, truth.direct_data, (SIDE, SIDE // 2, 2), truth.projector_shape)
    with pytest.raises(lm.InputError, match="colour"):
        seen(colour, np.zeros((2, 2), int))


def test_statistics_of_a_matrix_known_by_hand() -> None:
    made = ProceduralScene((1, 3), (2, 2)).truth()
    dense = np.array([[8, 1, 0.5, 0.5], [1, 1, 1, 1], [0, 0, 0, 0]], np.float32)
    matrix = type(made.matrix)(dense)
    truth = Truth(matrix, matrix.data / 2, (1, 3), (2, 2))
    assert direct_share(truth) == pytest.approx(0.5)
    assert entries_for_energy(truth, 0.8).tolist() == [1, 4, 0]
    assert entries_for_energy(truth, 0.9).tolist() == [2, 4, 0]
    assert entries_for_energy(truth, 0.5).tolist() == [1, 2, 0]
    low, high = clipped_share(truth, (1e-6, 1e6), count=64)
    assert low == 0
    assert 0.5 < high < 2 / 3 + 1e-9


def test_blur_may_differ_from_row_to_row() -> None:
    truth = ProceduralScene((6, 7), (12, 10)).truth()
    sigmas = np.where(np.arange(truth.matrix.shape[0]) % 3 == 0, 1.3, 0.0)
    mixed = varying_defocus(truth, sigmas)
    for sigma in (0.0, 1.3):
        rows = np.flatnonzero(sigmas == sigma)
        whole = defocus(truth, sigma)
        for actual, expected in ((mixed.matrix, whole.matrix), (mixed.direct, whole.direct)):
            np.testing.assert_allclose(
                actual[rows].toarray(), expected[rows].toarray(), rtol=1e-3, atol=2e-3
            )
