"""`layers`: surfaces seen through each other and in mirrors, of matrices that are known exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.errors import InputError, OutputError
from lightmatrix.simulation.truth import binned

SHAPE = (16, 24)


def rig() -> lm.RigGeometry:
    """A projector 1 to the right of a camera of the same lens, so that light shifts by 40 / z."""
    camera = np.array([[40.0, 0, 11.5, 0], [0, 40, 7.5, 0], [0, 0, 1, 0]])
    projector = camera.copy()
    projector[0, 3] = -40
    return lm.RigGeometry(camera, projector, SHAPE, SHAPE)


def composed() -> lm.LightTransport:
    """A gauze at z = 4 that returns 30 % of the light before a wall at z = 10, and a reflection.

    Rows of the camera from 12 on show light of other rows of the projector too, as mirrors do.
    """
    row, col = np.indices(SHAPE)
    light = np.zeros((*SHAPE, *SHAPE), np.float32)
    for depth, share in ((4, 0.3), (10, 0.6)):
        seen = col >= 40 // depth
        light[row[seen], col[seen], row[seen], col[seen] - 40 // depth] = share
    light[12:, 12:, 3, 2] = 0.4
    matrix = csr_array(light.reshape(row.size, -1))
    return lm.LightTransport.from_matrix(matrix, SHAPE, SHAPE)


def test_both_surfaces_near_to_far_and_what_a_mirror_shows() -> None:
    found = lm.layers(composed(), rig())
    both = found.depth[2:-4, 12:-2]
    np.testing.assert_allclose(both[..., 0], 4, rtol=1e-4)
    np.testing.assert_allclose(both[..., 1], 10, rtol=1e-4)
    np.testing.assert_allclose(found.light[2:-4, 12:-2, :2], [[[0.3, 0.6]] * 10] * 10, rtol=1e-4)
    np.testing.assert_allclose(found.points[..., 2], found.depth)
    # Nothing lies to the left of the projector's image.
    assert np.isnan(found.depth[:, :4]).all()
    # Light off the line has a place, but no depth, and comes last.
    assert found.mirrored[13:, 13:-1, 2].all()
    assert not found.mirrored[:12].any()
    np.testing.assert_allclose(found.place[14, 14, 2], [3, 2])
    assert np.isnan(found.depth[14, 14, 2])
    assert (found.probability[np.isfinite(found.depth)] >= 0.5).all()
    assert found.summary()["mirrored_pixels"] == found.mirrored.any(axis=-1).sum()
    # What `triangulate` keeps is one of the layers.
    known = binned(lm.truth("corner"), 4)
    assert known.geometry is not None
    shape = lm.triangulate(known.transport(), known.geometry)
    layers = lm.layers(known.transport(), known.geometry)
    assert (layers.depth == shape.depth[..., None]).any(axis=-1)[shape.kept].all()


def test_files(tmp_path: Path) -> None:
    known = composed()
    found = lm.layers(known, rig(), output=tmp_path / "l.ply", picture=tmp_path / "l.png")
    trimesh = pytest.importorskip("trimesh")
    read = trimesh.load(tmp_path / "l.ply", process=False)
    held = np.isfinite(found.depth)
    np.testing.assert_allclose(read.vertices, found.points[held])
    data = read.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(data["layer"].ravel(), np.nonzero(held)[2] + 1)
    np.testing.assert_allclose(data["probability"].ravel(), found.probability[held])
    exr = pytest.importorskip("OpenEXR")
    lm.layers(known, rig(), output=tmp_path / "l.exr")
    with exr.File(str(tmp_path / "l.exr"), separate_channels=True) as opened:
        channels = {name: channel.pixels for name, channel in opened.channels().items()}
    np.testing.assert_array_equal(channels["layer2.Z"], found.depth[..., 1])
    np.testing.assert_array_equal(channels["layer1.Y"], found.light[..., 0])
    assert len(channels) == 9
    with pytest.raises(OutputError, match="exists already"):
        lm.layers(known, rig(), output=tmp_path / "l.exr")
    with pytest.raises(InputError, match="no surface is found"):
        lm.layers(known, rig(), least_probability=1, output=tmp_path / "none.ply")
