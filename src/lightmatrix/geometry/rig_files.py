"""Files of a rig's geometry: ours, and those of other programs; docs/calibration.md lists them.

`READERS` holds how each program's files are read, `write_rig` how they are written.
"""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import GEOMETRY_FORMAT, OUR_MARK
from lightmatrix.files.reading import check_version, parse_json, read_bytes, read_text

Values = dict[str, Any]
Array = NDArray[np.float64]
Contents = Mapping[Path, Values]
VERSION = 1
# Names that programs give to the same things, see `_plain`. SLMaster's second camera has M2, R and
# T, and its projector M4, Rlp and Tlp; its S is the camera's width and height. One widely copied
# program misspells rotation.
_NAMES = {
    "camera_intrinsics": "cameraintrinsics camk camint cameramatrix1 cameramatrix k1 m1 kc kcam "
    "intrinsicscamera cameraintrinsic mtx1 kkleft",
    "projector_intrinsics": "projectorintrinsics projk projint m4 cameramatrix2 projectormatrix k2 "
    "m2 kp kproj intrinsicsprojector projectorintrinsic mtx2 kkright",
    "camera_distortion": "cameradistortion camkc camdist distcoeffs1 distcoeffs d1 dist1 distcam "
    "cameradistcoeffs cameradistortioncoefficients kclens kcleft",
    "projector_distortion": "projectordistortion projkc projdist d4 distcoeffs2 d2 dist2 distproj "
    "projectordistcoeffs projectordistortioncoefficients kplens kcright",
    "rotation": "rotation rlp rproj rp r rotationmatrix roration",
    "translation": "translation tlp tproj tp t tvec",
    # As rows and columns, and as width and height.
    "camera_shape": "camerashape imgshape",
    "projector_shape": "projectorshape",
    "camera_size": "camerasize cameraresolution camsize camres imagesize imagesize1 s",
    "projector_size": "projectorsize projectorresolution projsize projres imagesize2",
    "rms": "rms stereoerror stereorms rmsstereo",
}


def read_rig(path: Path) -> Values:
    """What a file, or a folder of two files, states of a rig.

    Fields of `RigGeometry`, unchecked, or with "rotation" arguments of `from_intrinsics`, of which
    "camera_shape" and "projector_shape" may be missing.
    """
    if (path / "geometry.json").is_file():
        path /= "geometry.json"
    files = [path]
    if path.is_dir():
        endings = (".yml", ".yaml", ".xml", ".json")
        files = sorted(each for each in path.iterdir() if each.suffix.lower() in endings)
        if len(files) != 2:
            raise InputError(
                f"{path}: holds no geometry.json, and not two files of a calibration",
                hint="give one file, or a folder with two: intrinsics.yml and extrinsics.yml of "
                "OpenCV, or camera.yaml and projector.yaml of ROS",
            )
    contents = {file: _content(file) for file in files}
    for read in READERS.values():
        if (values := read(contents)) is not None:
            return values
    raise InputError(
        f"{path}: holds no geometry of a rig",
        hint="give a file of `lightmatrix calibrate`, or of another program with camera and "
        "projector matrices, R and T; in MATLAB: s = toStruct(stereoParams); save stereo.mat s",
    )


def _content(file: Path) -> Values:
    """What a file holds by name: arrays, or as JSON and mat files nest it."""
    start = read_bytes(file)[:8]
    if start in (b"MATLAB 7", b"\x89HDF\r\n\x1a\n"):
        raise InputError(f"{file}: is of MATLAB's version 7.3", hint="save it with the option -v7")
    try:
        if start == b"MATLAB 5":
            return dict(scipy.io.loadmat(file, simplify_cells=True))
        # Files of arrays, images and point clouds begin so, and hold no geometry.
        if b"\0" in start or start.startswith((b"PK", b"ply")):
            return {}
        text = read_text(file).strip()
        model = re.search(r"distortion_model\W+(\w+)", text)
        if model and model[1] not in ("plumb_bob", "rational_polynomial"):
            raise InputError(f"{file}: a lens of the model {model[1]}", hint="use plumb_bob")
        if text.startswith("{"):
            return dict(parse_json(text, str(file)))
        if text.startswith("<"):
            return {
                each.tag: _numbers(each.findtext("data", each.text) or "", each.findtext("rows"))
                for each in ElementTree.fromstring(text)
            }
    except InputError:
        raise
    # Damaged mat files raise nearly anything.
    except Exception as error:
        raise InputError(f"{file}: cannot be read ({error})", hint="is it damaged?") from error
    # The entries of YAML begin at the margin; what they hold is indented, or a list.
    values: Values = {}
    for entry in re.split(r"^(?=\w)", text, flags=re.MULTILINE):
        name, _, rest = entry.partition(":")
        rows = re.search(r"^\s*rows:\s*(\d+)", rest, flags=re.MULTILINE)
        values[name] = _numbers(rest.rpartition("data:")[2], rows and rows[1])
    return values


def _numbers(text: str, rows: str | None) -> Array | None:
    """The numbers of a text as an array of so many rows; None if there is anything else."""
    # Calibrations keep all corners beside their matrices, of which the largest is 4 x 4.
    words = [] if len(text) > 4000 else re.split(r"[\s,\[\]]+", text)
    return _array({"data": [word for word in words if word not in ("", "-")], "rows": rows or 1})


def _array(value: Any) -> Array | None:
    """A value as an array of numbers; None if it is anything else."""
    try:
        # OpenCV's matrices, in JSON.
        if isinstance(value, dict):
            value = np.reshape(np.array(value["data"], np.float64), (int(value["rows"]), -1))
        array = np.array(() if value is None else value, np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    return array.reshape(3, 3) if array.size == 9 else array if 0 < array.size <= 16 else None


def _plain(content: Values) -> dict[str, Array]:
    """The arrays of a file by their names, in lower case without "_" and "-".

    SLStudio has Kc and kc, K and the distortion, which become kc and kclens.
    """
    plain: dict[str, Array] = {}
    for name, value in content.items():
        if (array := _array(value)) is not None:
            key = re.sub("[_-]", "", name.lower())
            plain[f"{key}lens" if re.fullmatch("k[cp]", name) else key] = array
    # It states a size as two numbers.
    sizes = {"camerasize": "framewidth frameheight", "projectorsize": "screenresx screenresy"}
    for size, sides in sizes.items():
        if set(sides.split()) <= plain.keys():
            plain[size] = np.concatenate([plain[side].ravel() for side in sides.split()])
    return plain


# How each program's files are read: None if they are of another program.


def _ours(contents: Contents) -> Values | None:
    (file, content), *more = contents.items()
    if more or not str(content.get("format")).startswith("lightmatrix-"):
        return None
    if content["format"] != GEOMETRY_FORMAT:
        hint = "give a file of `lightmatrix calibrate`"
        raise InputError(f"{file}: is not a {GEOMETRY_FORMAT} file", hint=hint)
    check_version(file, content.get("version"), VERSION)
    return content


def _matlab(contents: Contents) -> Values | None:
    (file, content), *_ = contents.items()
    if (found := _group(content, "CameraParameters1")) is None:
        return None
    values: Values = {}
    try:
        for number, device in ((1, "camera"), (2, "projector")):
            part = found[f"CameraParameters{number}"]
            # Older versions store K and R transposed, for points as rows. Pixels count from 1.
            matrix = part["K"] if "K" in part else np.transpose(part["IntrinsicMatrix"])
            values[f"{device}_intrinsics"] = np.array(matrix) - [[0, 0, 1], [0, 0, 1], [0, 0, 0]]
            k1, k2, *k3 = np.ravel(part["RadialDistortion"])
            values[f"{device}_distortion"] = [k1, k2, *np.ravel(part["TangentialDistortion"]), *k3]
            values[f"{device}_shape"] = tuple(int(n) for n in np.ravel(part["ImageSize"]))
        units = str(part.get("WorldUnits") or "")
        short = {"millimeters": "mm", "centimeters": "cm", "meters": "m"}
        values["units"] = short.get(units, units) or None
        if pose := found.get("PoseCamera2"):
            return values | {"rotation": pose["R"], "translation": pose["Translation"]}
        turn = np.transpose(found["RotationOfCamera2"])
        return values | {"rotation": turn, "translation": found["TranslationOfCamera2"]}
    except (KeyError, TypeError, ValueError) as error:
        hint = "save them with jsonencode(stereoParams), or toStruct(stereoParams) as .mat"
        raise InputError(f"{file}: its stereoParameters lack {error}", hint=hint) from error


def _group(content: Any, name: str) -> Values | None:
    """The group that holds a name, in a group of groups."""
    if not isinstance(content, dict) or name in content:
        return content if isinstance(content, dict) else None
    return next((each for value in content.values() if (each := _group(value, name))), None)


def _ros(contents: Contents) -> Values | None:
    """A pair of camera_info: R and P lead from each device's frame to the one that both share."""
    names = ["cameramatrix k", "distortioncoefficients d", "rectificationmatrix r"]
    names += ["projectionmatrix p", "imagewidth width", "imageheight height"]
    devices = []
    for file, content in contents.items():
        plain = _plain(content)
        parts = [plain[each] for name in names for each in name.split() if each in plain]
        if len(parts) != len(names) or parts[3].size != 12:
            return None
        shared = parts[3].reshape(3, 4)
        if np.linalg.matrix_rank(shared[:, :3]) < 3:
            raise InputError(
                f"{file}: is not calibrated: its P has no inverse", hint="calibrate it"
            )
        shift = np.linalg.solve(shared[:, :3], shared[:, 3])
        # The second device of a pair stands beside the origin.
        order = "proj" in file.name.lower(), float(np.abs(shift).max())
        devices.append((order, parts, shift))
    if len(devices) != 2:
        hint = "put those of camera and projector into a folder, and give the folder"
        raise InputError(f"{next(iter(contents))}: is the camera_info of one device", hint=hint)
    (_, one, origin), (_, other, beside) = sorted(devices, key=lambda each: each[0])
    values: Values = {"rotation": other[2].T @ one[2]}
    values["translation"] = other[2].T @ (beside - origin)
    for device, parts in (("camera", one), ("projector", other)):
        values |= {f"{device}_intrinsics": parts[0], f"{device}_distortion": parts[1]}
        values[f"{device}_shape"] = int(parts[5].item()), int(parts[4].item())
    return values


def _named(contents: Contents) -> Values | None:
    """Matrices by their names, in one file or in two."""
    plain = {name: each for content in contents.values() for name, each in _plain(content).items()}
    found: Values = {}
    for name, others in _NAMES.items():
        if (first := next((each for each in others.split() if each in plain), None)) is not None:
            found[name] = plain[first]
    needed = ("camera_intrinsics", "projector_intrinsics", "rotation", "translation")
    words = ("camera intrinsics (K)", "projector intrinsics (K)", "rotation (R)", "translation (T)")
    missing = [word for name, word in zip(needed, words, strict=True) if name not in found]
    if len(missing) == len(needed):
        return None
    if missing:
        raise InputError(
            f"{next(iter(contents))}: names no {' and no '.join(missing)}",
            hint="name the matrices cam_K, proj_K, R and T, and the distortions cam_kc and "
            "proj_kc; of OpenCV's intrinsics.yml and extrinsics.yml give the folder",
        )
    rms = found.pop("rms", None)
    if rms is not None and rms.size == 1:
        found["rms"] = {"stereo": float(rms.item())}
    for device in ("camera", "projector"):
        # OpenCV states a size as width and height.
        size = found.pop(f"{device}_size", None)
        shape = found.pop(f"{device}_shape", None if size is None else size.ravel()[::-1])
        if shape is not None:
            found[f"{device}_shape"] = tuple(int(n) for n in np.ravel(shape))
    return found


READERS: dict[str, Callable[[Contents], Values | None]] = {
    "lightmatrix": _ours,
    "MATLAB": _matlab,
    "ROS": _ros,
    "OpenCV and others": _named,
}


def write_rig(part: Path, rig: Any) -> None:
    """Write a geometry to a file, in the format of its ending, or into a folder of COLMAP's."""
    if part.suffix == ".json":
        content = {"format": GEOMETRY_FORMAT, "version": VERSION, **rig.as_dict()}
        part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        return
    skew = max(abs(rig.camera_intrinsics[0, 1]), abs(rig.projector_intrinsics[0, 1]))
    if rig.projector_mirrored or rig.projector_stagger or (part.is_dir() and skew > 1e-6):
        what = "diamond pixels" if rig.projector_stagger else "skewed pixels"
        what = "a mirrored projector" if rig.projector_mirrored else what
        raise OutputError(f"this format cannot state {what}", hint="save it as .json")
    if part.is_dir():
        _write_colmap(part, rig)
        return
    cv2 = load_opencv("writing a file of OpenCV", "shape")
    storage = cv2.FileStorage(str(part), cv2.FILE_STORAGE_WRITE)
    storage.writeComment(f"{OUR_MARK}, unit of length: {rig.units or 'unknown'}")
    for number, device in ((1, "camera"), (2, "projector")):
        storage.write(f"M{number}", getattr(rig, f"{device}_intrinsics"))
        storage.write(f"D{number}", getattr(rig, f"{device}_distortion")[None])
        storage.write(f"imageSize{number}", np.array([getattr(rig, f"{device}_shape")[::-1]]))
    storage.write("R", rig.rotation)
    storage.write("T", rig.translation[:, None])
    storage.release()


def _write_colmap(part: Path, rig: Any) -> None:
    """COLMAP's text files: the camera is image 1, the projector image 2."""
    texts = {"cameras": "", "images": "", "points3D": ""}
    for number, device in ((1, "camera"), (2, "projector")):
        rows, cols = getattr(rig, f"{device}_shape")
        matrix, lens = getattr(rig, f"{device}_intrinsics"), getattr(rig, f"{device}_distortion")
        # The corner of COLMAP's first pixel is (0, 0), which OpenCV counts from its centre.
        numbers = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5, *lens[:4]]
        model = f"{number} FULL_OPENCV {cols} {rows}"
        texts["cameras"] += f"{model} {_spaced([*numbers, lens[4], 0, 0, 0])}\n"
        pose = np.linalg.solve(matrix, getattr(rig, f"{device}_matrix"))
        x, y, z, w = scipy.spatial.transform.Rotation.from_matrix(pose[:, :3]).as_quat()
        # The points that an image shows would stand in the line below.
        texts["images"] += (
            f"{number} {_spaced([w, x, y, z, *pose[:, 3]])} {number} {device}.png\n\n"
        )
    for name, text in texts.items():
        (part / f"{name}.txt").write_text(f"# {OUR_MARK}\n{text}", encoding="ascii")


def _spaced(numbers: list[Any]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
