"""`triangulate`: depth of known scenes from T and from codes, its files, and what it refuses."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_array

import lightmatrix as lm
from experiments.shape import depths_within
from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.extras import write_exr
from lightmatrix.shape.shape import Shape, ShapeTest, surface_faces
from lightmatrix.shape.spots import find_line_spots, uncut_places
from lightmatrix.simulation.truth import binned


class Known(lm.Truth):
    """A scene whose geometry is known."""

    geometry: lm.RigGeometry


@cache
def triangulated(scene: str) -> tuple[Known, Shape]:
    """A bundled scene and its shape, which takes seconds; no test changes them."""
    known = cast(Known, lm.truth(scene))
    return known, lm.triangulate(known.transport(), known.geometry)


@cache
def small(scene: str, factor: int = 4) -> Known:
    """A scene at fewer pixels, where its accuracy does not matter."""
    return cast(Known, binned(lm.truth(scene), factor))


def errors(shape: Shape, known: lm.Truth) -> NDArray[np.float64]:
    """Distances of the depths from the nearest surface in their pixels, NaN where there is none."""
    within = depths_within(known, 4)
    return np.asarray(np.fmin.reduce(np.abs(shape.depth[..., None] - within), axis=-1))


def rig(rows: int = 12, cols: int = 16) -> lm.RigGeometry:
    """A projector 1 to the right of a camera of the same lens."""
    camera = np.array([[20.0, 0, 7.5, 0], [0, 20, 5.5, 0], [0, 0, 1, 0]])
    projector = camera.copy()
    projector[0, 3] = -20
    return lm.RigGeometry(camera, projector, (rows, cols), (rows, cols))


@pytest.mark.parametrize("scene", ["corner", "l_objects"])
def test_depths_of_known_scenes(scene: str) -> None:
    known, shape = triangulated(scene)
    error = errors(shape, known)
    right = error <= 0.01 * 4
    assert shape.kept.mean() > 0.98
    assert right[shape.kept].mean() > 0.97
    assert np.sqrt((error[right] ** 2).mean()) < 0.007
    # Most errors are within two stated standard deviations, which are no wild guess either.
    assert (error[right] < 2 * shape.uncertainty[right]).mean() > 0.9
    assert np.median(shape.uncertainty[right]) < 0.02


def test_normals_of_walls() -> None:
    known, shape = triangulated("corner")
    assert known.normals is not None
    cosine = (shape.normals * known.normals).sum(axis=-1)
    assert np.nanmedian(cosine) > np.cos(np.radians(3))


def test_a_higher_probability_keeps_fewer_points_and_fewer_wrong_ones() -> None:
    known, usual = triangulated("metal")
    sure = lm.triangulate(known.transport(), known.geometry, least_probability=0.99)
    assert (usual.kept | ~sure.kept).all()
    assert (usual.probability[usual.kept] >= 0.5).all()
    wrong = [(errors(shape, known)[shape.kept] > 0.04).mean() for shape in (usual, sure)]
    assert sure.kept.mean() > 0.75
    assert wrong[1] < 0.2 * wrong[0]
    # A stricter tolerance makes all points less probable.
    close = lm.triangulate(known.transport(), known.geometry, tolerance=0.003)
    assert close.probability.mean() < usual.probability.mean() - 0.02
    with pytest.raises(InputError, match=r"tolerance of 0\.0"):
        lm.triangulate(known.transport(), known.geometry, tolerance=0.0)
    with pytest.raises(InputError, match=r"probability of 1\.5"):
        lm.triangulate(known.transport(), known.geometry, least_probability=1.5)


def test_codes_feed_the_same_triangulation(tmp_path: Path) -> None:
    known = triangulated("corner")[0]
    code = lm.make_patterns("graycode", (64, 64), inverse=True)
    capture = lm.simulate(known, code, exposure=0.5)
    matches = lm.decode(capture, output=tmp_path / "c.npz")
    shape = lm.triangulate(tmp_path / "c.npz", known.geometry)
    right = errors(shape, known) < 0.04
    assert right.mean() > 0.95
    # Columns alone suffice where the epipolar lines cross them.
    columns = lm.decode(capture.select(np.arange(12)))
    alone = lm.triangulate(columns, known.geometry)
    assert (errors(alone, known) < 0.04).mean() > 0.8
    assert matches.light is not None


def test_a_reflection_off_the_line_is_passed_over() -> None:
    geometry = rig()
    true, stray = (5, 4), (9, 10)
    row = np.zeros((12, 16), np.float32)
    row[true], row[true[0], true[1] + 1], row[stray] = 0.5, 0.5, 3
    whole = np.zeros((192, 192), np.float32)
    whole[5 * 16 + 10] = row.ravel()
    transport = lm.LightTransport.from_matrix(csr_array(whole), (12, 16), (12, 16))
    # One pixel without neighbours is no probable surface.
    shape = lm.triangulate(transport, geometry, least_probability=0)
    np.testing.assert_allclose(shape.place[5, 10], [5, 4.5], atol=1e-5)
    # Disparity 10 - 4.5 = 20 * 1 / depth.
    assert shape.depth[5, 10] == pytest.approx(20 / 5.5, rel=1e-5)
    assert shape.test[0, 0] == ShapeTest.NO_LIGHT
    weak = lm.triangulate(transport, geometry)
    assert weak.test[5, 10] == ShapeTest.IMPROBABLE
    assert weak.probability[5, 10] == shape.probability[5, 10] < 0.5
    # Without a point there is no file.
    with pytest.raises(lm.InputError, match="no point is found"):
        lm.triangulate(transport, geometry, output="none.ply")


def test_the_brightest_three_by_three_pixels_are_the_spot() -> None:
    """Against sums over dense windows."""
    generator = np.random.default_rng(2)
    shape, count = (9, 11), 20
    dense = generator.random((count, *shape)) * (generator.random((count, *shape)) < 0.4)
    angle = generator.uniform(0, np.pi, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lines = np.column_stack([normal, -(normal * [5, 4]).sum(axis=1)])
    row, col = np.indices(shape)
    pixels = np.column_stack([col.ravel(), row.ravel()]).astype(float)
    places, lights, widths, total = find_line_spots(
        csr_array(dense.reshape(count, -1)), np.ones(count), lines, pixels, shape, 1.5
    )
    np.testing.assert_allclose(total, dense.sum(axis=(1, 2)) + 1)
    first = places[:, 0], lights[:, 0], widths[:, 0]
    for light, line, place, held, width in zip(dense, lines, *first, strict=True):
        distance = np.abs(line[0] * col + line[1] * row + line[2])
        padded = np.pad(light, 1)
        sums = sum(padded[i : i + shape[0], j : j + shape[1]] for i in range(3) for j in range(3))
        sums = np.where((distance <= 1.5) & (light > 0), sums, 0)
        centre = np.array(np.unravel_index(int(np.argmax(sums)), shape), float)
        for _ in range(4):
            share = np.clip(2 - np.abs(row - centre[0]), 0, 1)
            share = share * np.clip(2 - np.abs(col - centre[1]), 0, 1) * light
            centre = np.array([(share * row).sum(), (share * col).sum()]) / share.sum()
        np.testing.assert_allclose(place, centre, atol=1e-9)
        assert held == pytest.approx(share.sum())
        squared = (row - centre[0]) ** 2 + (col - centre[1]) ** 2
        assert width**2 == pytest.approx((share * squared).sum() / share.sum() / 2)


def test_spots_that_the_border_cuts_off_move_out_along_the_line() -> None:
    lines = np.array([[0.6, 0.8, -(0.6 * 5 - 0.8 * 0.7)], [1.0, 0, -5], [0.6, 0.8, -3.0]])
    place = np.array([[0.02, 5.0], [0.02, 5.0], [4.0, 5.0]])
    moved = uncut_places(place, lines, (10, 10), 0.5)
    np.testing.assert_allclose(moved, np.array([[-0.7, 5], [0.02, 5], [4, 5]]))


def test_files(tmp_path: Path) -> None:
    known = small("l_objects", 2)
    known.geometry.save(tmp_path / "rig.json")
    known.save(tmp_path / "T.npz")
    files = {"output": tmp_path / "cloud.ply", "depth": tmp_path / "depth.tif"}
    shape = lm.triangulate(tmp_path / "T.npz", tmp_path / "rig.json", mesh=True, **files)  # type: ignore[arg-type]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "depth.tif"), shape.depth)
    faces = surface_faces(shape.depth, shape.geometry)
    trimesh = pytest.importorskip("trimesh")
    shape.save(tmp_path / "cloud.obj", mesh=True)
    shape.save(tmp_path / "cloud.xyz")
    points = shape.points[shape.kept]
    np.testing.assert_allclose(np.loadtxt(tmp_path / "cloud.xyz"), points, rtol=1e-6)
    for name in ("cloud.ply", "cloud.obj"):
        read = trimesh.load(tmp_path / name, process=False)
        # trimesh leaves out points of an OBJ file that are in no triangle.
        used = np.unique(faces) if name.endswith("obj") else np.flatnonzero(shape.kept)
        np.testing.assert_allclose(read.vertices, shape.points.reshape(-1, 3)[used], rtol=1e-6)
        assert len(read.faces) == len(faces)
        # Triangles face the camera, as the normals do.
        assert (read.face_normals[:, 2] > 0).mean() > 0.99
        grey = np.asarray(read.visual.vertex_colors)[:, 0]
        assert np.corrcoef(grey, shape.albedo.ravel()[used] ** (1 / 2.2))[0, 1] > 0.99
    for name in ("cloud.ply", "cloud.obj", "cloud.xyz"):
        with pytest.raises(OutputError, match="exists already"):
            shape.save(tmp_path / name)
        shape.save(tmp_path / name, overwrite=True)
    with pytest.raises(OutputError, match=r"ends in \.stl"):
        shape.save(tmp_path / "cloud.stl")


def test_a_depth_image_is_in_millimetres(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known, found = triangulated("corner")
    shape = replace(found, geometry=replace(known.geometry, units="m"))
    shape.save(tmp_path / "depth.png")
    levels = lm.read_image(tmp_path / "depth.png")
    assert levels.dtype == np.uint16
    expected = np.where(shape.kept, 1000 * shape.depth, 0)
    np.testing.assert_allclose(levels, expected, atol=0.51)
    far = replace(shape, depth=20 * shape.depth)
    with pytest.warns(lm.LightMatrixWarning, match=r"beyond 65\.5 m"):
        far.save(tmp_path / "far.png")
    assert lm.read_image(tmp_path / "far.png").max() < 65535
    for unit, words in ((None, "geometry is unknown"), ("px", "geometry is 'px'")):
        geometry = replace(known.geometry, units=unit)
        with pytest.raises(InputError, match=words):
            replace(shape, geometry=geometry).save(tmp_path / "unknown.png")
        # Refused before anything is computed.
        monkeypatch.setattr("lightmatrix.shape.triangulation.seen_by", None)
        with pytest.raises(InputError, match=words):
            lm.triangulate(known.transport(), geometry, depth=tmp_path / "x.PNG")


def mirrored(matches: lm.Correspondence) -> lm.Correspondence:
    place = matches.place * [1, -1] + [0, 63]
    return replace(matches, place=place.astype(np.float32))


def turned(matches: lm.Correspondence) -> lm.Correspondence:
    return replace(matches, place=63 - matches.place)


def shuffled(matches: lm.Correspondence) -> lm.Correspondence:
    place = np.random.default_rng(0).permutation(matches.place.reshape(-1, 2))
    return replace(matches, place=place.reshape(matches.place.shape))


@pytest.mark.parametrize("scene", ["corner", "metal"])
@pytest.mark.parametrize("wrong", [mirrored, turned, shuffled])
def test_light_that_lies_on_its_line_by_chance_only_is_refused(
    scene: str, wrong: Callable[[lm.Correspondence], lm.Correspondence]
) -> None:
    known = triangulated(scene)[0]
    matches = lm.correspondence(known.transport())
    assert lm.triangulate(matches, known.geometry).kept.mean() > 0.8
    with pytest.raises(InputError, match="the geometry does not fit: camera pixels see") as refused:
        lm.triangulate(wrong(matches), known.geometry)
    assert "the geometry of this rig" in (refused.value.hint or "")


def test_a_matrix_of_a_mirrored_projector_is_refused() -> None:
    """Most rows hold some faint light beside their line, but few their brightest spot."""
    known = triangulated("corner")[0]
    order = np.arange(64 * 64).reshape(64, 64)[:, ::-1].ravel()
    matrix = csr_array(known.transport().sparse[:, order])
    transport = lm.LightTransport.from_matrix(matrix, (64, 64), (64, 64))
    with pytest.raises(InputError, match=r"light 18 projector pixels off .*; 3 % see"):
        lm.triangulate(transport, known.geometry)


def test_places_a_column_off_are_said() -> None:
    """The lines of `metal` run aslant: most places lie within a pixel still, but not near."""
    known = triangulated("metal")[0]
    matches = lm.correspondence(known.transport())
    place = np.add(matches.place, [0, 1]).astype(np.float32)
    beside = replace(matches, place=place)
    with pytest.warns(
        lm.LightMatrixWarning, match=r"0\.53 projector pixels off .* 8\d % see .* 8\d % give"
    ):
        lm.triangulate(beside, known.geometry)


@pytest.mark.parametrize(("name", "zoom", "turn"), [("zoomed", 0.98, 0.0), ("turned", 1.0, 1.0)])
def test_a_camera_that_was_touched_after_its_calibration_is_said(
    name: str, zoom: float, turn: float
) -> None:
    """Places move by a fraction of a pixel, and depths by more than what is tolerated."""
    known = triangulated("l_objects")[0]
    matches = lm.correspondence(known.transport())
    angle = np.deg2rad(turn)
    matrix = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places = matrix @ (np.indices((64, 64)).reshape(2, -1) - 31.5) + 31.5
    moved = [
        map_coordinates(
            matches.place[..., axis], places.reshape(2, 64, 64), order=0, mode="nearest"
        )
        for axis in (0, 1)
    ]
    # The camera sees between its pixels what lies there.
    ahead = places.reshape(2, 64, 64) - np.rint(places.reshape(2, 64, 64))
    place = (np.stack(moved) + ahead).transpose(1, 2, 0).astype(np.float32)
    with pytest.warns(lm.LightMatrixWarning, match="the geometry does not fit"):
        lm.triangulate(replace(matches, place=place), known.geometry)


def looking(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix of a camera, or projector, of 64 x 64 pixels that looks at the origin."""
    ahead = -place / np.linalg.norm(place)
    right = np.cross(ahead, [0, 1, 0]) / np.linalg.norm(np.cross(ahead, [0, 1, 0]))
    turn = np.stack([right, np.cross(ahead, right), ahead])
    intrinsics = np.array([[128, 0, 31.5], [0, 128, 31.5], [0, 0, 1]])
    return np.asarray(intrinsics @ np.column_stack([turn, -turn @ place]))


def test_the_geometry_of_another_rig_is_said() -> None:
    """A camera below the projector, not beside it: distances by hand, from the lines of F."""
    known = triangulated("l_objects")[0]
    places = np.array([[0.1, -1.2, 4.0], [0.0, 0.0, 4.0]])
    other = lm.RigGeometry(looking(places[0]), looking(places[1]), (64, 64), (64, 64))
    for source in (known.transport(), lm.correspondence(known.transport())):
        with pytest.warns(lm.LightMatrixWarning, match="is this the geometry") as warned:
            lm.triangulate(source, other)
        found = re.search(r"light ([\d.]+) projector .*; (\d+) % see", str(warned[0].message))
        assert found is not None
        lit = lm.correspondence(known.transport()).place[..., ::-1].reshape(-1, 2)
        seen = np.indices((64, 64))[::-1].reshape(2, -1).T
        lines = np.column_stack([seen, np.ones(len(seen))]) @ other.fundamental_matrix().T
        away = np.abs((lines[:, :2] * lit).sum(axis=1) + lines[:, 2])
        away /= np.hypot(lines[:, 0], lines[:, 1])
        assert float(found[2]) == pytest.approx(100 * (away <= 1).mean(), abs=2)
        assert float(found[1]) == pytest.approx(np.median(away), rel=0.05)


@pytest.mark.parametrize("kind", ["npz", "png", "PNG", "exr"])
def test_maps_of_other_programs_are_triangulated(tmp_path: Path, kind: str) -> None:
    known, _ = triangulated("corner")
    matches = lm.correspondence(known.transport())
    y, x = np.moveaxis(matches.place, -1, 0)
    y[:4], x[:4] = np.nan, np.nan
    file = tmp_path / ("SEEN_X.PNG" if kind == "PNG" else f"seen-x.{kind}")
    if kind == "npz":
        np.savez(file, x=x, y=y)
    elif kind != "exr":
        for axis, values in (("x", x), ("y", y)):
            levels = np.rint(np.nan_to_num(values, nan=65535)).astype(np.uint16)
            levels[4] = 0
            name = f"SEEN_{axis}.PNG".upper() if kind == "PNG" else f"seen-{axis}.png"
            lm.write_image(tmp_path / name, levels)
    else:
        pytest.importorskip("OpenEXR")
        write_exr(file, np.stack([x, y, 0 * x], axis=-1))
    shape = lm.triangulate(file, known.geometry, least_probability=0)
    whole = kind in ("png", "PNG")
    assert not shape.kept[: 5 if whole else 4].any()
    assert shape.kept[5:].mean() > 0.98
    # Whole pixels are a quarter of a pixel off.
    assert np.nanmedian(errors(shape, known)) < (0.08 if whole else 0.01)
    wrong = replace(known.geometry, projector_shape=(32, 32))
    with pytest.raises(InputError, match="of a projector of 32 x 32"):
        lm.triangulate(file, wrong)


def test_images_that_are_no_map_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    lm.write_image(tmp_path / "grey.exr", np.ones((4, 4), np.float32))
    lm.write_image(tmp_path / "photograph.png", np.ones((4, 4), np.uint16))
    lm.write_image(tmp_path / "x.png", np.zeros((4, 4), np.uint16))
    lm.write_image(tmp_path / "y.png", np.zeros((4, 4), np.uint16))
    np.savez(tmp_path / "other.npz", x=np.ones((4, 4)), y=np.ones((4, 5)))
    for name in ("m-x.png", "m-y.png"):
        lm.write_image(tmp_path / name, np.ones((4, 4), np.uint8))
    # What `map` writes, as shares of an image, is not read as pixels.
    matrix = small("metal").transport()
    lm.map_projector(matrix, output=tmp_path / "shares.exr", reverse=True)
    np.savez(tmp_path / "shares.npz", x=np.full((4, 4), 0.5), y=np.ones((4, 4)))
    for name, words in {
        "grey.exr": "one channel",
        "photograph.png": "no image of a pair",
        "x.png": "no camera pixel sees",
        "other.npz": "x and y of shapes",
        "m-y.png": "map of 8 bits",
        "shares.exr": "between 0 and 1",
        "shares.npz": "between 0 and 1",
    }.items():
        with pytest.raises(InputError, match=words):
            lm.triangulate(tmp_path / name, rig())


@pytest.mark.parametrize("view", ["depth", "normals", "layers"])
def test_views_of_a_shape(view: str, tmp_path: Path) -> None:
    known = small("metal", 2)
    matrix, geometry = known.transport(), known.geometry
    if view == "layers":
        expected = lm.layers(matrix, geometry).depth
    else:
        expected = getattr(lm.triangulate(matrix, geometry), view)
    assert np.isnan(expected).any()
    for name in ("x.npy", "x.tiff"):
        lm.show(matrix, view, geometry=geometry, output=tmp_path / name)
    np.testing.assert_array_equal(np.load(tmp_path / "x.npy"), expected)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "x.tiff"), expected)
    lm.show(matrix, view, geometry=geometry, output=tmp_path / "x.png")
    with pytest.raises(InputError, match="without a geometry"):
        lm.show(matrix, view)


def test_colours_of_normals_do_not_depend_on_the_frame_of_the_world() -> None:
    known = small("corner")
    geometry = known.geometry
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    whole = np.eye(4)
    whole[:3, :3] = turn
    turned = replace(
        geometry,
        camera_matrix=geometry.camera_matrix @ whole,
        projector_matrix=geometry.projector_matrix @ whole,
    )
    one, other = (lm.triangulate(known.transport(), rig) for rig in (geometry, turned))
    np.testing.assert_allclose(other.camera_normals, one.camera_normals, atol=1e-3)
    # A surface faces the camera, whose axis points away from it.
    assert (one.camera_normals[one.kept][:, 2] < 0).mean() > 0.99


def test_binned_captures_scale_the_geometry_and_others_are_refused() -> None:
    known = small("corner")
    matrix = known.transport()
    fine = known.geometry
    camera = np.diag([2.0, 2, 1]) @ fine.camera_matrix + np.outer(
        [0.5, 0.5, 0], fine.camera_matrix[2]
    )
    large = replace(fine, camera_matrix=camera, camera_shape=(32, 31))
    scaled, exact = lm.triangulate(matrix, large), lm.triangulate(matrix, fine)
    np.testing.assert_allclose(scaled.depth, exact.depth, rtol=1e-4)
    other = replace(fine, projector_shape=(16, 25))
    with pytest.raises(InputError, match="projector images of 16 x 25 pixels, but these") as bad:
        lm.triangulate(matrix, other)
    assert "calibrate at their size" in (bad.value.hint or "")


def test_rows_that_state_a_large_error_are_less_probable() -> None:
    known = small("corner")
    plain = known.transport()
    stated = np.full(plain.shape[0], 0.1, np.float32)
    stated[70] = 1.2
    of = [
        lm.triangulate(replace(plain, diagnostics={"estimated_error": error}), known.geometry)
        for error in (stated, np.full_like(stated, 0.1))
    ]
    fell = of[1].probability.ravel() - of[0].probability.ravel()
    assert fell[70] > 0
    assert (np.delete(fell, 70) == 0).all()
    # Where a row always clips with its strongest pixel, nothing tells how much brighter it is than
    # its neighbours: the place is unknown by half the width of the spot, unless more is tolerated.
    clipping = replace(plain, diagnostics={"only_bounded": np.ones_like(stated)})
    for tolerance, certain in ((0.01, False), (0.2, True)):
        found = lm.triangulate(clipping, known.geometry, tolerance=tolerance).probability
        usual = lm.triangulate(plain, known.geometry, tolerance=tolerance).probability
        assert ((found > 0.99).mean() > 0.1) == certain
        assert (usual > 0.99).mean() > 0.1


def test_files_take_their_places_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = small("corner")
    scene = (known.transport(), known.geometry)
    cloud, depth, picture = (tmp_path / f"a.{ending}" for ending in ("ply", "tif", "png"))

    def stopped(shape: Shape) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Shape, "show", stopped)
        with pytest.raises(KeyboardInterrupt):
            lm.triangulate(*scene, output=cloud, depth=depth, picture=picture)
    assert not list(tmp_path.iterdir())
    lm.triangulate(*scene, output=cloud, depth=depth, picture=picture)
    assert set(tmp_path.iterdir()) == {cloud, depth, picture}


def test_a_pcd_file_says_what_its_bytes_are(tmp_path: Path) -> None:
    _, shape = triangulated("corner")
    shape.save(tmp_path / "a.pcd")
    header, _, data = (tmp_path / "a.pcd").read_bytes().partition(b"DATA binary\n")
    lines = dict(each.split(" ", 1) for each in header.decode().splitlines())
    columns = zip(*(lines[name].split() for name in ("FIELDS", "TYPE", "SIZE")), strict=True)
    table = np.frombuffer(data, [(name, kind.lower() + size) for name, kind, size in columns])
    assert len(table) == int(lines["POINTS"]) == int(lines["WIDTH"]) == shape.kept.sum()
    points = np.stack([table["x"], table["y"], table["z"]], axis=1)
    np.testing.assert_array_equal(points, shape.points[shape.kept])
    np.testing.assert_array_equal(table["probability"], shape.probability[shape.kept])
    normal = shape.normals[shape.kept][:, 2]
    np.testing.assert_array_equal(table["normal_z"], np.nan_to_num(normal))
    # Red, green and blue, as PCL unpacks them.
    colour = table["rgb"].view(np.uint32)
    assert ((colour >> 16 & 255) == (colour & 255)).all()
    assert colour.max() == 0xFFFFFF
