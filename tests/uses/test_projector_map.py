"""The map of projector pixels: right to a tenth of a pixel, and read by other programs."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from lightmatrix.cli import main

CAMERA, PROJECTOR = (30, 44), (20, 25)


def _places() -> NDArray[np.float64]:
    """The camera place of each projector pixel: turned and enlarged, fractions of pixels."""
    row, col = np.indices(PROJECTOR)
    return np.stack([3.3 + 1.13 * row + 0.08 * col, 2.6 + 1.55 * col - 0.11 * row], axis=-1)


@pytest.fixture(scope="module")
def scene() -> lm.LightTransport:
    """Sharp spots in a faint light from everywhere; the first projector row lights nothing."""
    row, col = np.indices(CAMERA).reshape(2, -1, 1)
    place_row, place_col = _places().reshape(-1, 2).T
    spots = np.exp(-((row - place_row) ** 2 + (col - place_col) ** 2) / (2 * 0.7**2))
    spots[:, : PROJECTOR[1]] = 0
    sparse = csr_array(np.where(spots > 1e-4, spots, 0).astype(np.float32))
    background = np.full((sparse.shape[0], 4), 0.001, np.float32)
    return lm.LightTransport(sparse, background, CAMERA, PROJECTOR, (2, 2))


@pytest.fixture(scope="module")
def found(scene: lm.LightTransport) -> lm.ProjectorMap:
    return lm.map_projector(scene)


def test_places_are_right_to_a_tenth_of_a_pixel(found: lm.ProjectorMap) -> None:
    assert not found.known[0].any()
    assert found.known[1:].all()
    inside = (slice(2, -1), slice(1, -1))
    assert np.abs(found.place - _places())[inside].max() < 0.1
    assert (found.confidence[inside] > 0.9).all()
    # Back from there: the projector pixel that each of these camera pixels sees.
    assert found.reverse is not None
    assert found.reverse.place.shape == (*CAMERA, 2)
    row, col = np.rint(found.place[inside]).astype(int).reshape(-1, 2).T
    own = np.moveaxis(np.indices(PROJECTOR), 0, -1)[inside].reshape(-1, 2)
    assert np.abs(found.reverse.place[row, col] - own).max() < 0.6


def test_a_finer_camera_sees_larger_spots() -> None:
    """Each projector pixel lights 6 x 6 camera pixels, whose middle counts."""
    blocks = np.kron(np.eye(8, dtype=np.float32), np.ones((6, 1), np.float32))
    matrix = csr_array(np.kron(blocks, blocks))
    noisy = matrix.copy()
    noisy.data += 0.01 * np.random.default_rng(0).random(matrix.nnz, np.float32)
    found = lm.map_projector(lm.LightTransport.from_matrix(noisy, (48, 48), (8, 8)))
    expected = 6 * np.moveaxis(np.indices((8, 8)), 0, -1) + 2.5
    np.testing.assert_allclose(found.place, expected, atol=0.1)


def test_opencv_remaps_a_picture_to_the_projector(found: lm.ProjectorMap, tmp_path: Path) -> None:
    """A picture whose value is its own row, or column, shows where each projector pixel looks."""
    found.save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as stored:
        x, y = stored["map_x"], stored["map_y"]
    for axis, own in enumerate(np.indices(CAMERA, np.float32)):
        shown = cv2.remap(own + 100, x, y, cv2.INTER_LINEAR)
        assert np.abs(shown - 100 - _places()[..., axis])[2:-1, 1:-1].max() < 0.1
        # Black where no place is known.
        assert not shown[0].any()


def _uv() -> NDArray[np.float64]:
    """Texture coordinates from the lower left corner."""
    row, col = np.moveaxis(_places(), -1, 0)
    return np.stack([(col + 0.5) / CAMERA[1], 1 - (row + 0.5) / CAMERA[0]], axis=-1)


def test_an_stmap_is_read_by_others(found: lm.ProjectorMap, tmp_path: Path) -> None:
    found.save(tmp_path / "map.exr")
    with OpenEXR.File(str(tmp_path / "map.exr"), separate_channels=True) as opened:
        red, green, alpha = (opened.channels()[name].pixels for name in "RGA")
    inside = (slice(2, -1), slice(1, -1))
    # A tenth of a camera pixel is 0.0023 and more.
    assert np.abs(np.stack([red, green], axis=-1) - _uv())[inside].max() < 0.0023
    np.testing.assert_array_equal(alpha, found.known)
    assert not red[0].any()


def test_mpcdi_keeps_to_its_specification(found: lm.ProjectorMap, tmp_path: Path) -> None:
    """The elements and attributes that MPCDI 2.0 asks of the profile 2d, and no frustum."""
    found.save(tmp_path / "wall.mpcdi")
    with zipfile.ZipFile(tmp_path / "wall.mpcdi") as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    assert not any("/" in name for name in names)
    text = (tmp_path / "mpcdi.xml").read_text()
    assert text.startswith('<?xml version="1.0" encoding="utf-8"?>')
    root = ElementTree.fromstring(text)
    assert root.tag == "MPCDI"
    assert set(root.attrib) == {"profile", "geometry", "color", "date", "version"}
    assert [root.attrib[k] for k in ("profile", "geometry", "color", "version")] == [
        "2d", "2", "2", "2.0",
    ]  # fmt: skip
    assert [child.tag for child in root] == ["display", "files"]
    (buffer,) = root.iterfind("display/buffer")
    (region,) = buffer
    size = {"xResolution": "25", "yResolution": "20"}
    assert (
        region.attrib == {"id": "projector", "x": "0", "y": "0", "xSize": "1", "ySize": "1"} | size
    )
    assert [step.tag for step in region.iterfind("color/*")] == ["decode", "encode"]
    assert region.find("frustum") is None
    (files,) = root.iterfind("files/fileset")
    assert files.attrib == {"region": region.attrib["id"]}
    paths = {part.tag: str(part.findtext("path")) for part in files}
    assert list(paths) == ["geometryWarpFile", "alphaMap", "betaMap"]
    assert set(paths.values()) | {"mpcdi.xml"} == set(names)
    for name in ("alphaMap", "betaMap"):
        assert files.findtext(f"{name}/bitDepth") == "8"
        assert files.findtext(f"{name}/componentDepth") == "1"
    assert float(str(files.findtext("alphaMap/gammaEmbedded"))) == 1
    assert files.findtext("geometryWarpFile/interpolation") == "linear"

    def read(part: str) -> Any:
        return cv2.imread(str(tmp_path / paths[part]), cv2.IMREAD_UNCHANGED)

    warp = read("geometryWarpFile")[..., ::-1]
    assert np.abs(warp[..., :2] - _uv())[2:-1, 1:-1].max() < 0.0023
    assert np.isnan(warp[0, :, :2]).all()
    # An error of 1 marks places that are unknown.
    np.testing.assert_array_equal(warp[..., 2] == 1, ~found.known)
    np.testing.assert_array_equal(read("alphaMap"), np.where(found.known, 255, 0))
    assert not read("betaMap").any()


def test_a_pair_of_images_holds_columns_and_rows(found: lm.ProjectorMap, tmp_path: Path) -> None:
    found.save(tmp_path / "map.png")
    for axis, name in ((1, "map-x.png"), (0, "map-y.png")):
        image = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.dtype == np.uint16
        place = image / 65535 * CAMERA[axis] - 0.5
        assert np.abs(place - _places()[..., axis])[2:-1, 1:-1].max() < 0.1
        assert not image[0].any()
    with pytest.raises(lm.OutputError, match="exists already"):
        found.save(tmp_path / "map.png")


def test_light_leaks_reads_its_set(found: lm.ProjectorMap, tmp_path: Path) -> None:
    camera = np.array([[40.0, 0, 22, 0], [0, 40, 15, 0], [0, 0, 1, 0]])
    projector = np.array([[30.0, 0, 12, -9], [0, 30, 10, 0], [0, 0, 1, 0]])
    geometry = lm.RigGeometry(camera, projector, CAMERA, PROJECTOR)
    found.save(tmp_path / "scan", geometry=geometry)
    image = cv2.imread(str(tmp_path / "scan" / "proMap.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    # OpenCV has blue first: column and row of the camera are red and green.
    assert np.abs(image[..., :0:-1] - _places()[..., ::-1])[2:-1, 1:-1].max() < 0.6
    confidence = lm.read_image(tmp_path / "scan" / "proConfidence.exr")
    np.testing.assert_array_equal(confidence[1:], found.confidence[1:])
    points = lm.read_image(tmp_path / "scan" / "xyzMap.exr")
    expected = geometry.triangulate(found.place[9, 9:10, ::-1], [[9, 9]])[0]
    np.testing.assert_allclose(points[9, 9], expected, rtol=1e-5)
    with pytest.raises(lm.InputError, match="holds no points"):
        found.save(tmp_path / "scan.mpcdi", geometry=geometry)
    other = lm.RigGeometry(camera, projector, (8, 8), PROJECTOR)
    with pytest.raises(lm.InputError, match="geometry of a camera of 8 x 8"):
        found.save(tmp_path / "other", geometry=other)


def test_the_command_maps_both_ways(
    scene: lm.LightTransport, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lm.save(tmp_path / "scene.zarr", scene)
    words = ["map", str(tmp_path / "scene.zarr"), "-o"]
    assert main([*words, str(tmp_path / "wall.mpcdi")]) == 0
    assert "95.0 % of the projector pixels have a place" in capsys.readouterr().out
    assert main([*words, str(tmp_path / "back.npz"), "--reverse"]) == 0
    with np.load(tmp_path / "back.npz") as stored:
        assert stored["map_x"].shape == CAMERA
    assert main([*words, str(tmp_path / "wall.tga")]) == 2
    assert "no map ends in .tga" in capsys.readouterr().err
    # Only what we wrote is replaced.
    (tmp_path / "foreign.mpcdi").write_bytes(b"PK")
    assert main([*words, str(tmp_path / "foreign.mpcdi"), "--overwrite"]) == 2
    assert main([*words, str(tmp_path / "wall.mpcdi"), "--overwrite"]) == 0
