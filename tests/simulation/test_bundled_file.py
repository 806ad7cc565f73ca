"""Packed truths: small, and as good as the truths they were made from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bundled_scenes import SAMPLES, write_bundled
from hypothesis import given, settings
from hypothesis import strategies as st

from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.simulation import library
from lightmatrix.simulation.library import read_bundled
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.simulate import irradiance
from lightmatrix.simulation.truth import Truth


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.integers(0, 100),
)
def test_a_bundled_file_loses_little(
    tmp_path_factory: pytest.TempPathFactory,
    camera: tuple[int, int],
    projector: tuple[int, int],
    seed: int,
) -> None:
    truth = ProceduralScene(camera, projector, seed).truth()
    path = tmp_path_factory.mktemp("packed") / "scene.npz"
    write_bundled(path, truth)
    again = read_bundled(path)
    assert again.camera_shape == camera
    assert again.projector_shape == projector
    assert again.metadata == truth.metadata
    assert again.matrix.has_canonical_format
    # Half a step of the square root, and once more for the row's sum that is kept.
    largest = truth.matrix.max(axis=1).toarray()[:, None]
    allowed = 2.5 * np.sqrt(truth.matrix.toarray() * largest) / 511 + largest / 511**2
    assert (abs(again.matrix - truth.matrix).toarray() <= allowed).all()
    np.testing.assert_allclose(again.matrix.sum(axis=1), truth.matrix.sum(axis=1), rtol=1e-5)
    np.testing.assert_allclose(
        again.direct.toarray(), truth.direct.toarray(), atol=allowed.max() + largest.max() / 500
    )


def test_a_row_without_light_stays_dark(tmp_path: Path) -> None:
    truth = ProceduralScene((3, 3), (4, 4)).truth()
    rows = truth.matrix.toarray()
    rows[4] = 0
    matrix = type(truth.matrix)(rows)
    write_bundled(tmp_path / "scene.npz", replace(truth, matrix=matrix, direct_data=matrix.data))
    assert read_bundled(tmp_path / "scene.npz").matrix[[4]].nnz == 0


@pytest.fixture(scope="module", params=library.BUNDLED)
def bundled(request: pytest.FixtureRequest) -> Truth:
    return library.truth(request.param)


def test_bundled_scenes_obey_energy(bundled: Truth) -> None:
    matrix = bundled.matrix
    assert matrix.shape == (4096, 4096)
    assert (matrix.data > 0).all()
    assert (bundled.direct_data >= 0).all()
    assert (bundled.direct_data <= matrix.data).all()
    np.testing.assert_allclose(bundled.direct.data + bundled.indirect.data, matrix.data, rtol=1e-6)
    white = matrix.sum(axis=1)
    random = np.random.default_rng(0).random((4096, 4), dtype=np.float32)
    assert (matrix @ random <= white[:, None] * (1 + 1e-5)).all()
    # No surface returns more than it gets: light is shared among the camera pixels that see it,
    # each of which sees on average one projector pixel's worth of a surface.
    share = bundled.direct_data.sum() / matrix.sum()
    assert 0.5 < share < 0.99


def test_bundled_scenes_clip_as_agreed(bundled: Truth) -> None:
    largest = bundled.matrix.max(axis=1).toarray()
    assert np.quantile(largest, 0.8) == pytest.approx(1, abs=0.01)


def test_bundled_scenes_are_current(bundled: Truth) -> None:
    from lightmatrix.simulation.scenes import scene

    name = str(bundled.metadata["scene"])
    assert bundled.metadata["scene_version"] == scene(name).version
    assert bundled.metadata["samples"] == SAMPLES
    assert bundled.metadata["noise_entries"] < 0.01


def test_the_corner_clips_by_global_light_alone() -> None:
    truth = library.truth("corner")
    exposure = 0.99 / float(truth.matrix.max())
    light = irradiance(truth.matrix, BernoulliPatterns((64, 64), 8))
    assert (exposure * light >= 1).mean() > 0.1
    assert (exposure * truth.matrix.sum(axis=1) >= 1).mean() > 0.9
    # Direct light alone never clips there.
    assert exposure * truth.direct.max() < 1
