"""Spots that lie on their epipolar line by chance: they cross it, or are outshone."""

from __future__ import annotations

import numpy as np

from lightmatrix.uses.separation import crossing_spots, outshone_spots

SHAPE = (7, 9)


def test_a_mirror_image_that_crosses_its_line_is_told_from_a_surface() -> None:
    row = np.indices(SHAPE)[0].reshape(-1, 1)
    light = np.ones((63, 1))
    for sweep, crossing in ((1.8, True), (0.0, False)):
        # The distance to the line, which lies along the projector's rows, is the sweep's.
        distance = sweep * (row - 3)
        relative = np.stack([distance, 0 * distance], axis=-1).astype(float)
        found = crossing_spots(relative, light, np.abs(distance) < 0.6, SHAPE, 2.3)
        assert (found.reshape(SHAPE)[3] == crossing).all()


def test_faint_light_beside_the_line_does_not_reject_a_spot() -> None:
    row = np.indices(SHAPE)[0].reshape(-1, 1)
    distance = 1.8 * (row - 3.0)
    relative = np.stack([distance, 0 * distance], axis=-1)
    light = np.where(row == 3, 1.0, 0.3)
    assert not crossing_spots(relative, light, np.abs(distance) < 0.6, SHAPE, 2.3)[row == 3].any()


def test_the_stronger_surface_keeps_a_projector_pixel() -> None:
    # Two surfaces that claim pixels 10 to 14; the second one only faintly, and 20 by itself.
    col = np.array([10.0, 11, 12, 13, 14, 10.2, 11.2, 12.2, 20])
    place = np.stack([np.zeros(9), col], axis=1)
    parallax = np.array([0.0, 0, 0, 0, 0, 3, 3, 3, 3])
    light = np.array([1.0, 1, 1, 1, 1, 0.3, 0.3, 0.3, 0.3])
    doubtful = np.ones(9, bool)
    found = outshone_spots(place, parallax, light, doubtful)
    assert found.tolist() == [False] * 5 + [True] * 3 + [False]
    assert not outshone_spots(place, parallax, light, ~doubtful).any()
