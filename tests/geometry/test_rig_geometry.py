"""`RigGeometry`: round trips, agreement with OpenCV, files, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import lightmatrix as lm
from lightmatrix.geometry.rig_geometry import load_rig

LENS = np.array([-0.21, 0.08, 0.002, -0.003, 0.01])


def intrinsics(focal: float, centre: tuple[float, float]) -> np.ndarray:
    """K with pixels that are not quite square."""
    return np.array([[focal, 0, centre[0]], [0, 0.98 * focal, centre[1]], [0, 0, 1.0]])


def rig(seed: int = 0, *, distorted: bool = True) -> lm.RigGeometry:
    """A plausible rig: an arm's length apart, turned towards each other, mild distortion."""
    random = np.random.default_rng(seed)
    share = float(distorted)
    return lm.RigGeometry.from_intrinsics(
        intrinsics(900 + 100 * random.random(), (310, 250)),
        intrinsics(1100, (400 + 50 * random.random(), 500)),
        Rotation.from_euler("yxz", random.uniform(-20, 20, 3), degrees=True).as_matrix(),
        random.uniform(100, 300, 3) * [1, 0.3, 0.2],
        (480, 640),
        (600, 800),
        camera_distortion=share * LENS * random.uniform(0.2, 1, 5),
        projector_distortion=share * 0.5 * LENS * random.uniform(0.2, 1, 5),
        units="mm",
        rms={"stereo": 0.25},
    )


def points_before(geometry: lm.RigGeometry, seed: int, count: int = 50) -> np.ndarray:
    """Points within the camera's view, 800 to 1,500 units away, in the world's frame."""
    random = np.random.default_rng(seed)
    pixels = random.uniform(0, 1, (count, 2)) * np.array(geometry.camera_shape[::-1])
    rays = geometry.camera_rays(pixels)
    return geometry.camera_centre + rays * random.uniform(800, 1500, (count, 1))


@given(st.integers(0, 10_000))
def test_what_is_projected_is_triangulated(seed: int) -> None:
    geometry = rig(seed)
    points = points_before(geometry, seed)
    seen, lit = geometry.project_camera(points), geometry.project_projector(points)
    found = geometry.triangulate(seen, lit)
    usable = np.isfinite(found).all(axis=1)
    np.testing.assert_allclose(found[usable], points[usable], atol=1e-3)
    assert usable.mean() > 0.8
    np.testing.assert_allclose(geometry.depth(points), points[:, 2], atol=1e-9)


@given(st.integers(0, 10_000))
def test_lenses_can_be_undone(seed: int) -> None:
    geometry = rig(seed)
    pixels = np.random.default_rng(seed).uniform(0, 600, (40, 2))
    points = geometry.camera_centre + 900 * geometry.camera_rays(pixels)
    finite = np.isfinite(points).all(axis=1)
    np.testing.assert_allclose(geometry.project_camera(points)[finite], pixels[finite], atol=1e-3)
    assert finite.mean() > 0.8


@given(st.integers(0, 10_000))
def test_matches_lie_on_their_epipolar_lines(seed: int) -> None:
    geometry = rig(seed)
    points = points_before(geometry, seed)
    seen = geometry.undistort_camera(geometry.project_camera(points))
    lit = geometry.undistort_projector(geometry.project_projector(points))
    one = np.ones((len(points), 1))
    line = np.hstack([seen, one]) @ geometry.fundamental_matrix().T
    distance = (np.hstack([lit, one]) * line).sum(axis=1) / np.linalg.norm(line[:, :2], axis=1)
    assert np.nanmax(np.abs(distance)) < 1e-3


@given(st.integers(0, 10_000), st.floats(-5, 5).filter(lambda v: abs(v) > 0.01))
def test_matrices_of_any_scale_and_world_frame(seed: int, factor: float) -> None:
    own = rig(seed, distorted=False)
    world = np.eye(4)
    world[:3, :3] = Rotation.random(rng=seed).as_matrix()
    world[:3, 3] = np.random.default_rng(seed).normal(0, 500, 3)
    moved = lm.RigGeometry(
        factor * own.camera_matrix @ world,
        -factor * own.projector_matrix @ world,
        own.camera_shape,
        own.projector_shape,
    )
    np.testing.assert_allclose(moved.camera_intrinsics, own.camera_intrinsics, atol=1e-6)
    np.testing.assert_allclose(moved.projector_intrinsics, own.projector_intrinsics, atol=1e-6)
    np.testing.assert_allclose(moved.rotation, own.rotation, atol=1e-9)
    np.testing.assert_allclose(moved.translation, own.translation, atol=1e-6)
    assert moved.baseline == pytest.approx(own.baseline)
    points = points_before(moved, seed)
    found = moved.triangulate(moved.project_camera(points), moved.project_projector(points))
    usable = np.isfinite(found).all(axis=1)
    np.testing.assert_allclose(found[usable], points[usable], atol=1e-4)


def test_a_projector_pixel_off_its_line_counts_by_its_foot_on_the_line() -> None:
    geometry = rig(3, distorted=False)
    points = points_before(geometry, 3)
    seen, lit = geometry.project_camera(points), geometry.project_projector(points)
    line = np.column_stack([seen, np.ones(len(seen))]) @ geometry.fundamental_matrix().T
    across = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    found = geometry.triangulate(seen, lit + 2.5 * across)
    np.testing.assert_allclose(found, points, atol=1e-6)
    np.testing.assert_allclose(geometry.project_camera(found), seen, atol=1e-6)


def test_agrees_with_opencv() -> None:
    cv2: Any = pytest.importorskip("cv2")
    geometry = rig(7)
    points = points_before(geometry, 7)
    turn = cv2.Rodrigues(geometry.rotation)[0]
    theirs = cv2.projectPoints(
        points,
        turn,
        geometry.translation,
        geometry.projector_intrinsics,
        geometry.projector_distortion,
    )[0][:, 0]
    np.testing.assert_allclose(geometry.project_projector(points), theirs, atol=1e-6)


def test_binned_and_cropped_images_have_the_same_points() -> None:
    geometry = rig(5)
    points = points_before(geometry, 5)
    seen, lit = geometry.project_camera(points), geometry.project_projector(points)
    small = geometry.cropped((40, 16), (401, 600)).scaled(camera=(2, 4), projector=8)
    assert (small.camera_shape, small.projector_shape) == ((200, 150), (75, 100))
    # The block of 2 x 4 pixels at the corner has its centre at row 0.5, column 1.5.
    expected = (seen - [16 + 1.5, 40 + 0.5]) / [4, 2]
    np.testing.assert_allclose(small.project_camera(points), expected, atol=1e-9)
    np.testing.assert_allclose(small.project_projector(points), (lit - 3.5) / 8, atol=1e-9)
    found = small.triangulate(expected, (lit - 3.5) / 8)
    np.testing.assert_allclose(found, points, atol=1e-3)


def test_nothing_is_invented_beyond_the_field_of_view() -> None:
    barrel = lm.RigGeometry.from_intrinsics(
        np.diag([100, 100, 1]),
        np.diag([100, 100, 1]),
        np.eye(3),
        [1, 0, 0],
        (8, 8),
        (8, 8),
        camera_distortion=[-0.4],
    )
    # x (1 - 0.4 x^2) is at most 0.609, at x = 0.913.
    assert np.isfinite(barrel.undistort_camera([[60.0, 0]])).all()
    assert np.isnan(barrel.undistort_camera([[61.0, 0]])).all()
    assert np.isnan(barrel.triangulate([[61.0, 0]], [[0, 0]])).all()
    assert np.isnan(barrel.triangulate([[1.0, 0]], [[np.nan, 0]])).all()
    assert np.isnan(barrel.project_camera([[0.0, 0, -1]])).all()


def test_a_saved_geometry_is_the_same(tmp_path: Path) -> None:
    geometry = rig(11)
    geometry.save(tmp_path / "rig.json")
    again = lm.RigGeometry.load(tmp_path / "rig.json")
    for name in geometry.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(geometry, name))
    with pytest.raises(lm.OutputError):
        geometry.save(tmp_path / "rig.json")
    geometry.save(tmp_path / "rig.json", overwrite=True)


def as_yaml(values: dict[str, Any], *, tag: str = " !!opencv-matrix") -> str:
    """Matrices as OpenCV writes them, numbers and lists as they are."""
    text = ""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            rows, cols = value.shape
            text += f"{name}:{tag}\n   rows: {rows}\n   cols: {cols}\n"
            text += "   dt: d\n" if tag else ""
            text += f"   data: [ {', '.join(map(str, value.ravel().tolist()))} ]\n"
        else:
            text += f"{name}: {value}\n"
    return text


def as_xml(values: dict[str, Any]) -> str:
    text = '<?xml version="1.0"?>\n<opencv_storage>\n'
    for name, value in values.items():
        body = value
        if isinstance(value, np.ndarray):
            rows, cols = value.shape
            data = " ".join(map(str, value.ravel().tolist()))
            body = f"<rows>{rows}</rows><cols>{cols}</cols><dt>d</dt><data>\n    {data}</data>"
        text += f"<{name}>{body}</{name}>\n"
    return text + "</opencv_storage>\n"


def as_ros(known: lm.RigGeometry, device: str, *, echoed: bool = False) -> str:
    """The camera_info of a device: as its calibrator saves it, or as a topic shows it."""
    rows, cols = getattr(known, f"{device}_shape")
    # The axes of both rectified images lie along the baseline.
    across = known.rotation.T @ known.translation / -known.baseline
    down = np.cross([0, 0, 1], across) / np.linalg.norm(across[:2])
    both = np.stack([across, down, np.cross(across, down)])
    turn = both if device == "camera" else both @ known.rotation.T
    shared = np.diag([700.0, 700, 1]) @ np.eye(3, 4)
    if device == "projector":
        shared[0, 3] = -700 * known.baseline
    matrix, lens = getattr(known, f"{device}_intrinsics"), getattr(known, f"{device}_distortion")
    if echoed:
        parts = {"d": lens, "k": matrix, "r": turn, "p": shared}
        text = f"header:\n  stamp:\n    sec: 3\nheight: {rows}\nwidth: {cols}\n"
        for name, value in parts.items():
            text += f"{name}:\n" + "".join(f"- {number}\n" for number in value.ravel().tolist())
        return text + "roi:\n  x_offset: 0\n  height: 0\n"
    parts = {"camera_matrix": matrix, "distortion_coefficients": lens[None]}
    parts |= {"rectification_matrix": turn, "projection_matrix": shared}
    head = {"image_width": cols, "image_height": rows, "camera_name": device}
    return as_yaml({**head, **parts}, tag="")


def as_matlab(known: lm.RigGeometry, *, old: bool) -> dict[str, Any]:
    """What toStruct makes of stereoParameters."""
    found: dict[str, Any] = {}
    for number, device in ((1, "camera"), (2, "projector")):
        k1, k2, p1, p2, k3 = getattr(known, f"{device}_distortion").tolist()
        matrix = getattr(known, f"{device}_intrinsics").copy()
        # MATLAB counts pixels from 1.
        matrix[:2, 2] += 1
        found[f"CameraParameters{number}"] = {
            "RadialDistortion": [k1, k2, k3],
            "TangentialDistortion": [p1, p2],
            "ImageSize": getattr(known, f"{device}_shape"),
            "WorldUnits": "millimeters",
            "WorldPoints": np.zeros((300, 2)).tolist(),
            "EstimateSkew": False,
            "RotationVectors": np.zeros((4, 3)).tolist(),
            "ReprojectionErrors": [],
            "Version": {"Major": 9, "Minor": 3},
            **({"IntrinsicMatrix": matrix.T.tolist()} if old else {"K": matrix.tolist()}),
        }
    turn, shift = known.rotation, known.translation.tolist()
    found |= {"Version": {"Major": 9, "Minor": 3}, "RectificationParams": {"Q": np.eye(4).tolist()}}
    if old:
        return {**found, "RotationOfCamera2": turn.T.tolist(), "TranslationOfCamera2": shift}
    return {**found, "PoseCamera2": {"R": turn.tolist(), "Translation": shift}}


def write_calibration(folder: Path, program: str, known: lm.RigGeometry) -> Path:
    """A file, or a folder of two, as a program writes it."""
    k1, k2 = known.camera_intrinsics, known.projector_intrinsics
    d1, d2 = known.camera_distortion[None], known.projector_distortion[None]
    turn, shift = known.rotation, known.translation[:, None]
    more = {"E": np.eye(3), "corners": np.ones((400, 100)), "note": "left", "empty": "[]"}
    width, height = known.camera_shape[::-1]
    matrices = {"cam_K": k1, "cam_kc": d1, "proj_K": k2, "proj_kc": d2, "R": turn, "T": shift}
    slstudio = {"Kc": k1, "kc": d1.T, "Kp": k2, "kp": d2.T, "Rp": turn, "Tp": shift}
    slmaster = {"M1": k1, "D1": d1, "S": np.array([[width], [height]]), "M2": np.eye(3)}
    slmaster |= {"M4": k2, "D4": d2, "R": np.eye(3), "Rlp": turn, "Tlp": shift}
    kamino = {"img_shape": np.array([[height], [width]]), "rms": 0.25, "cam_int": k1}
    kamino |= {"cam_dist": d1, "proj_int": k2, "proj_dist": d2, "roration": turn}
    group = "settings:\n   name: left\n   M1: 3\n"
    files: dict[str, Callable[[], str]] = {
        "scan3d.yml": lambda: "%YAML:1.0\n---\n" + as_yaml({**matrices, "cam_error": 0.2, **more}),
        "slstudio.xml": lambda: as_xml({**slstudio, **more}),
        "slmaster.yml": lambda: "%YAML:1.0\n---\n" + group + as_yaml({**more, **slmaster}),
        "kamino.xml": lambda: as_xml({**kamino, "translation": shift, **more}),
        "stereo/intrinsics.yml": lambda: as_yaml({"M1": k1, "D1": d1, "M2": k2, "D2": d2}),
        "stereo/extrinsics.yml": lambda: as_yaml({"R": turn, "T": shift, "R1": np.eye(3)}),
        "ros/camera.yaml": lambda: as_ros(known, "camera"),
        "ros/projector.yaml": lambda: as_ros(known, "projector"),
        "ros2/right.yaml": lambda: as_ros(known, "projector", echoed=True),
        "ros2/left.yaml": lambda: as_ros(known, "camera", echoed=True),
        "matlab.json": lambda: json.dumps(as_matlab(known, old=False) | {"note": [1, "a"]}),
        "old.json": lambda: json.dumps({"stereoParams": as_matlab(known, old=True)}),
    }
    if program.endswith(".mat"):
        savemat(folder / program, {"s": as_matlab(known, old=program.startswith("old"))})
    for name, text in files.items():
        if name.split("/")[0] == program:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text())
    return folder / program


@pytest.mark.parametrize(
    ("program", "sizes"),
    [
        ("scan3d.yml", 0), ("slstudio.xml", 0), ("slmaster.yml", 1), ("kamino.xml", 1),
        ("stereo", 0), ("ros", 2), ("ros2", 2), ("matlab.json", 2), ("old.json", 2),
        ("stereo.mat", 2), ("old.mat", 2),
    ],
)  # fmt: skip
def test_files_of_other_programs_are_read(tmp_path: Path, program: str, sizes: int) -> None:
    """`sizes` devices of a file state the size of their images."""
    known = rig(3)
    file = write_calibration(tmp_path, program, known)
    if sizes < 2:
        with pytest.raises(lm.InputError, match=f"size of the {('camera', 'projector')[sizes]}"):
            lm.RigGeometry.load(file)
    # The images tell their sizes, before they were binned.
    sides = known.camera_shape
    matches = lm.Correspondence(
        np.zeros((*sides, 2), np.int32),
        np.zeros((*sides, 2), np.float32),
        np.ones(sides, np.float32),
        projector_shape=known.projector_shape,
    )
    read = lm.geometry_of(matches, file)
    assert (read.camera_shape, read.projector_shape) == (sides, known.projector_shape)
    for name in ("matrix", "distortion"):
        for device in ("camera", "projector"):
            one, other = (getattr(each, f"{device}_{name}") for each in (read, known))
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-6)
    assert read.units == ("mm" if "mat" in program or "old" in program else None)
    assert read.rms == ({"stereo": 0.25} if program == "kamino.xml" else {})


# Excerpts of what the programs themselves wrote, from public repositories: the example of SLStudio,
# scan3d-capture under Windows, and a stereo pair of ROS's calibrator.
REAL = {
    "slstudio.xml": """<?xml version="1.0"?>
<opencv_storage>
<Kc type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>f</dt><data>
    2.19512036e+03 0. 8.43500000e+02 0. 2.19512036e+03 6.75500000e+02 0. 0. 1.</data></Kc>
<kc type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>f</dt><data>
    -5.80352657e-02 0. 0. 0. 0.</data></kc>
<Kp type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>f</dt><data>
    2.60152563e+03 0. 8.66541504e+02 0. 2.60152563e+03 1.10911121e+03 0. 0. 1.</data></Kp>
<kp type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>f</dt><data>
    -3.14900056e-02 0. 0. 0. 0.</data></kp>
<Rp type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>f</dt><data>
    9.64402318e-01 -1.20346159e-01 2.35467508e-01 1.53437316e-01 9.79882836e-01
    -1.27619177e-01 -2.15372086e-01 1.59205735e-01 9.63466883e-01</data></Rp>
<Tp type_id="opencv-matrix"><rows>3</rows><cols>1</cols><dt>f</dt><data>
    -1.45282562e+02 -3.64983406e+01 6.79231644e+01</data></Tp>
<stereo_error>4.2199749739974501e-01</stereo_error>
<frameWidth>1688</frameWidth><frameHeight>1352</frameHeight>
<screenResX>1824</screenResX><screenResY>1140</screenResY>
</opencv_storage>
""",
    "scan3d.yml": """%YAML:1.0
cam_K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 3.6838333907732294e+003, 0., 1.2500944196559094e+003, 0.,
       3.6974474889257835e+003, 1.0122781917607587e+003, 0., 0., 1. ]
cam_kc: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -5.1558942293476151e-001, 7.9382621058611061e-002,
       1.9059474312756614e-004, 3.5905157827651230e-003, 0. ]
proj_K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 2.8013622132143819e+003, 0., 5.3714564964254430e+002, 0.,
       2.7957271561105604e+003, 8.1512682665321393e+002, 0., 0., 1. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 9.8097166816623960e-001, 1.9129352460664582e-002,
       -1.9320624764634459e-001, 3.8199208382748290e-003,
       9.9303996753376567e-001, 1.1771589138823595e-001,
       1.9411335466663360e-001, -1.1621398691626285e-001,
       9.7407100089525933e-001 ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 1.7194845987298550e+001, -1.2098438607071827e+001,
       -6.8266691762771616e+000 ]
stereo_error: 4.7143570184252465e-001
""",
    "ros/left.yaml": """image_width: 1312
image_height: 541
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [853.415831, 0.0, 641.228450, 0.0, 852.608357, 167.569232, 0.0, 0.0, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.251963, 0.096396, -0.002254, -0.001636, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999479, -0.000960, 0.032258, 0.000688, 0.999964, 0.008463, -0.032265,
    -0.008436, 0.999444]
projection_matrix:
  rows: 3
  cols: 4
  data: [834.752703, 0.0, 612.806038, 0.0, 0.0, 834.752703, 158.305822, 0.0, 0.0, 0.0, 1.0, 0.0]
""",
    "ros/right.yaml": """image_width: 1312
image_height: 541
camera_name: narrow_stereo/right
camera_matrix:
  rows: 3
  cols: 3
  data: [851.257609, 0.0, 637.135422, 0.0, 851.168364, 154.698218, 0.0, 0.0, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.239563, 0.084455, -0.002111, -0.000161, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999997, -0.001336, 0.002140, 0.001354, 0.999963, -0.008449, -0.002129,
    0.008452, 0.999962]
projection_matrix:
  rows: 3
  cols: 4
  data: [834.752703, 0.0, 612.806038, -190.372340, 0.0, 834.752703, 158.305822, 0.0,
    0.0, 0.0, 1.0, 0.0]
""",
}


@pytest.mark.parametrize(
    ("name", "sizes", "focal", "principal", "distortion", "baseline"),
    [
        # SLStudio states the sizes of both images; scan3d-capture none, so they are those of T.
        ("slstudio.xml", ((1352, 1688), (1140, 1824)), 2601.5256, 1109.1112, -0.0314900, 164.477),
        ("scan3d.yml", ((1536, 2048), (1080, 1920)), 2801.3622, 815.12683, 0, 22.10517),
        # The translation is the shift of the second projection matrix over its focal length.
        (
            "ros",
            ((541, 1312), (541, 1312)),
            851.257609,
            154.698218,
            -0.239563,
            190.37234 / 834.7527,
        ),
    ],
)
def test_real_files_of_other_programs_are_read(
    tmp_path: Path, name: str, sizes: tuple[tuple[int, int], tuple[int, int]], focal: float,
    principal: float, distortion: float, baseline: float,
) -> None:  # fmt: skip
    (tmp_path / "ros").mkdir()
    for file, text in REAL.items():
        (tmp_path / file).write_text(text)
    read = load_rig(tmp_path / name, usual=((1536, 2048), (1080, 1920)))
    assert (read.camera_shape, read.projector_shape) == sizes
    known = read.projector_intrinsics
    np.testing.assert_allclose([known[0, 0], known[1, 2]], (focal, principal), rtol=1e-5)
    assert read.projector_distortion[0] == pytest.approx(distortion)
    assert read.baseline == pytest.approx(baseline, rel=1e-4)
    # The projector stands to the right in all but scan3d-capture's.
    assert (read.translation[0] < 0) == (name != "scan3d.yml")


def test_one_file_of_two_and_other_saves_of_matlab_are_explained(tmp_path: Path) -> None:
    write_calibration(tmp_path, "stereo", rig())
    write_calibration(tmp_path, "ros", rig())
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    (tmp_path / "cut.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    (tmp_path / "cloud.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\n\xff")
    np.savez(tmp_path / "points.npz", x=np.zeros(3))
    (tmp_path / "half.json").write_text('{"CameraParameters1": {}}')
    for name, words in {
        "stereo/intrinsics.yml": "names no rotation .R. and no translation .T.",
        "ros/camera.yaml": "the camera_info of one device",
        ".": "holds no geometry.json, and not two files",
        "cloud.ply": "holds no geometry",
        "points.npz": "holds no geometry",
        "new.mat": "version 7.3",
        "cut.mat": "cannot be read",
        "half.json": "stereoParameters lack 'IntrinsicMatrix'",
    }.items():
        with pytest.raises(lm.InputError, match=words):
            lm.RigGeometry.load(tmp_path / name)


@pytest.mark.parametrize("ending", ["xml", "yml"])
def test_opencv_reads_what_is_written(tmp_path: Path, ending: str) -> None:
    cv2: Any = pytest.importorskip("cv2")
    geometry, file = rig(2), tmp_path / f"rig.{ending}"
    geometry.save(file)
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    parts = {name: storage.getNode(name).mat() for name in ("M1", "D1", "M2", "D2", "R", "T")}
    storage.release()
    points = points_before(geometry, 2)
    turn = cv2.Rodrigues(parts["R"])[0]
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), parts["M1"], parts["D1"])[0][:, 0]
    lit = cv2.projectPoints(points, turn, parts["T"], parts["M2"], parts["D2"])[0][:, 0]
    np.testing.assert_allclose(seen, geometry.project_camera(points), atol=1e-6)
    np.testing.assert_allclose(lit, geometry.project_projector(points), atol=1e-6)
    again = lm.RigGeometry.load(file)
    assert again.projector_shape == geometry.projector_shape
    np.testing.assert_allclose(again.projector_matrix, geometry.projector_matrix, atol=1e-9)
    geometry.save(file, overwrite=True)
    with pytest.raises(lm.OutputError, match="cannot state a mirrored projector"):
        replace(geometry, projector_mirrored=True).save(file, overwrite=True)


def stored(**changes: object) -> str:
    """A good geometry as its file, with changes."""
    matrix = np.eye(3, 4) * 10
    content: dict[str, object] = {
        "format": "lightmatrix-geometry",
        "version": 1,
        "camera_matrix": matrix.tolist(),
        "projector_matrix": (matrix - 5 * np.eye(3, 4, 3)).tolist(),
        "camera_shape": [8, 8],
        "projector_shape": [8, 8],
        "camera_distortion": [0.0] * 5,
        "projector_distortion": [0.0] * 5,
    }
    return json.dumps({**content, **changes})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no geometry"),
        ("[1, 2]", "no geometry|is not a lightmatrix-geometry"),
        ('{"format": "lightmatrix-response", "version": 1}', "is not a lightmatrix-geometry"),
        (stored(camera_matrix="wide"), "projection matrix"),
        (stored(camera_matrix=[[1.0, 0, 0, 0]] * 2), "projection matrix"),
        (stored().replace("10.0", "1e999", 1), "too large|not finite|cannot be read"),
        (stored(camera_shape=[0, 8]), "an image of the camera"),
        (stored(camera_distortion=[0.1] * 6), "6 coefficients"),
        ("col,row\n1,2\n", "holds no geometry"),
        ("{}", "holds no geometry"),
        ('{"format": "lightmatrix-geometry", "version": 2}', "format version 2"),
        ('{"format": "lightmatrix-geometry", "version": 1}', "lacks camera_distortion"),
        ('{"cam_K": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}', "names no projector intrinsics"),
        ("<?xml version='1.0'?><opencv_storage>", "cannot be read"),
        ("%YAML:1.0\n---\nalpha: 1\n", "holds no geometry"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "rig.json"
    file.write_text(text)
    with pytest.raises(lm.InputError, match=message):
        lm.RigGeometry.load(file)


def test_impossible_rigs_are_refused() -> None:
    good, shape = np.eye(3, 4), (4, 4)
    other = np.hstack([np.eye(3), [[1], [0], [0]]])
    geometry = lm.RigGeometry(good, other, shape, shape)
    for camera, projector, size, message in (
        (good, 2 * good, shape, "same centre"),
        (np.diag([1, 1, 0, 1])[:3], other, shape, "singular"),
        (good[:2], other, shape, "not finite"),
        (good, other, (4, 0), "an image of the camera"),
    ):
        with pytest.raises(lm.InputError, match=message):
            lm.RigGeometry(camera, projector, size, shape)
    turn = 2 * np.eye(3)
    with pytest.raises(lm.InputError, match="no rotation"):
        lm.RigGeometry.from_intrinsics(np.eye(3), np.eye(3), turn, [1, 0, 0], shape, shape)
    with pytest.raises(lm.InputError, match="1 camera pixels and 2"):
        geometry.triangulate([[1, 2]], [[1, 2], [1, 2]])
    with pytest.raises(lm.InputError, match="blocks of 5 x 5"):
        geometry.scaled(camera=5)
    with pytest.raises(lm.InputError, match="crop"):
        geometry.cropped((2, 0), shape)


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (np.array([[900.0, 0, 0], [0, 900, 0], [320, 240, 1]]), "below its diagonal"),
        (np.array([[900.0, 0, 320], [3, 900, 240], [0, 0, 1]]), "below its diagonal"),
        (np.diag([8.0, 8, 1]), "focal lengths of 8 and 8"),
        (np.diag([1.4, 1.4, 1]), "focal lengths of 1.4 and 1.4"),
    ],
    ids=["MATLAB", "skew", "millimetres", "normalised"],
)
def test_other_conventions_of_intrinsics_are_refused(camera: np.ndarray, words: str) -> None:
    with pytest.raises(lm.InputError, match=words):
        lm.RigGeometry.from_intrinsics(
            camera, intrinsics(1100, (400, 500)), np.eye(3), [200, 0, 0], (480, 640), (600, 800)
        )


@pytest.mark.parametrize("lens", [[500.0], [-30, 900], [0, 0, 3]])
def test_a_lens_beyond_reason_is_refused(lens: list[float]) -> None:
    with pytest.raises(lm.InputError, match="projector's distortion moves a corner"):
        replace(rig(), projector_distortion=np.append(lens, np.zeros(5 - len(lens))))


def test_a_stated_size_counts_before_that_of_the_file(tmp_path: Path) -> None:
    rig().save(tmp_path / "rig.json")
    read = lm.RigGeometry.load(tmp_path / "rig.json", camera_shape=(960, 1280))
    assert (read.camera_shape, read.projector_shape) == ((960, 1280), rig().projector_shape)


def test_a_geometry_of_other_images_needs_a_stated_bin(tmp_path: Path) -> None:
    whole = replace(rig(), camera_shape=(1024, 1280))
    transport = lm.truth("metal").transport()
    geometry = replace(whole, projector_shape=(64, 64))
    with pytest.raises(lm.InputError, match="1024 x 1280 pixels, but these are of 64 x 64"):
        lm.geometry_of(transport, geometry)
    stated = {"capture_description": {"bin_camera": [16, 20]}}
    assert lm.geometry_of(replace(transport, provenance=stated), geometry).camera_shape == (64, 64)
    # A file without sizes is of the photographs before they were binned.
    file = write_calibration(tmp_path, "scan3d.yml", rig())
    found = lm.geometry_of(replace(transport, provenance=stated), file)
    assert (found.camera_shape, found.projector_shape) == ((64, 64), (64, 64))
    assert found.camera_intrinsics[0, 0] == pytest.approx(rig().camera_intrinsics[0, 0] / 20)


def test_a_colmap_model_has_the_same_projections(tmp_path: Path) -> None:
    cv2: Any = pytest.importorskip("cv2")
    geometry = rig(2)
    geometry.save(tmp_path / "rig.colmap")
    lines = {
        name: (tmp_path / "rig.colmap" / f"{name}.txt").read_text().splitlines()[1:]
        for name in ("cameras", "images", "points3D")
    }
    # The second line of an image holds its points.
    assert (lines["points3D"], lines["images"][1::2]) == ([], ["", ""])
    points = points_before(geometry, 2)
    expected = geometry.project_camera(points), geometry.project_projector(points)
    for camera, image, pixels in zip(lines["cameras"], lines["images"][::2], expected, strict=True):
        number, model, width, _, *numbers = camera.split()
        fx, fy, cx, cy, *lens = map(float, numbers)
        _, *pose, owner, _ = image.split()
        w, x, y, z, *shift = map(float, pose)
        assert (model, owner) == ("FULL_OPENCV", number)
        assert int(width) == (640 if number == "1" else 800)
        turn = Rotation.from_quat([x, y, z, w]).as_rotvec()
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        shown = cv2.projectPoints(points, turn, np.array(shift), matrix, np.array(lens))[0][:, 0]
        # COLMAP counts pixels from the corner of the first one.
        np.testing.assert_allclose(shown - 0.5, pixels, atol=1e-6)
    skewed = lm.RigGeometry(
        np.array([[900.0, 5, 300, 0], [0, 900, 200, 0], [0, 0, 1, 0]]),
        geometry.projector_matrix, (480, 640), (600, 800),
    )  # fmt: skip
    with pytest.raises(lm.OutputError, match="cannot state skewed pixels"):
        skewed.save(tmp_path / "other.colmap")
