"""Truth files: what is written is read, by us and by SciPy, and bad files are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.sparse

from lightmatrix.errors import InputError
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.truth import Truth


@pytest.fixture
def truth() -> Truth:
    return ProceduralScene((5, 7), (6, 4), seed=3).truth()


def test_a_truth_survives_its_file(truth: Truth, tmp_path: Path) -> None:
    path = tmp_path / "T.npz"
    truth.save(path)
    again = Truth.load(path)
    assert again.camera_shape == (5, 7)
    assert again.projector_shape == (6, 4)
    assert again.metadata == truth.metadata
    np.testing.assert_array_equal(again.matrix.toarray(), truth.matrix.toarray())
    np.testing.assert_array_equal(again.direct.toarray(), truth.direct.toarray())
    assert again.matrix.dtype == np.float32


def test_scipy_reads_a_truth_file(truth: Truth, tmp_path: Path) -> None:
    truth.save(tmp_path / "T.npz")
    matrix = scipy.sparse.load_npz(tmp_path / "T.npz")
    np.testing.assert_array_equal(matrix.toarray(), truth.matrix.toarray())


def test_direct_and_global_light_make_the_whole(truth: Truth) -> None:
    whole = truth.direct.toarray() + truth.indirect.toarray()
    np.testing.assert_allclose(whole, truth.matrix.toarray(), rtol=1e-6)


def test_files_that_are_no_truth_are_named(truth: Truth, tmp_path: Path) -> None:
    path = tmp_path / "T.npz"
    with pytest.raises(InputError, match="no such file"):
        Truth.load(path)
    with pytest.raises(InputError, match="folder"):
        Truth.load(tmp_path)
    path.write_bytes(b"not an archive")
    with pytest.raises(InputError, match=r"T\.npz"):
        Truth.load(path)
    path.unlink()
    truth.save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match="cannot be read"):
        Truth.load(path)
    np.savez(path, data=np.ones(3))
    with pytest.raises(InputError, match="no sparse matrix"):
        Truth.load(path)
    scipy.sparse.save_npz(path, scipy.sparse.eye_array(4, format="csr"))
    with pytest.raises(InputError, match="shapes"):
        Truth.load(path)


def test_shapes_that_contradict_the_matrix_are_refused(truth: Truth, tmp_path: Path) -> None:
    path = tmp_path / "T.npz"
    truth.save(path)
    with np.load(path) as file:
        content = dict(file)
    np.savez(path, **{**content, "camera_shape": np.array([5, 8])})
    with pytest.raises(InputError, match=r"camera \(5, 8\)"):
        Truth.load(path)
    np.savez(path, **{**content, "projector_shape": np.array([6, 5])})
    with pytest.raises(InputError, match=r"projector \(6, 5\)"):
        Truth.load(path)
    np.savez(path, **{**content, "lightmatrix_truth": np.array(99)})
    with pytest.raises(InputError, match="format version 99"):
        Truth.load(path)
    np.savez(path, **{**content, "direct_data": content["direct_data"][1:]})
    with pytest.raises(InputError, match="direct"):
        Truth.load(path)
