"""Files of a rig's geometry: ours, and those of other programs; docs/calibration.md lists them.

`READERS` holds how each program's files are read, `write_rig` how they are written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.kinds import GEOMETRY_FORMAT, OUR_MARK
from lightmatrix.files.reading import check_version, parse_json, read_bytes, read_text

Values = dict[str, Any]
Contents = Mapping[Path, Values]
VERSION = 1
# Names that programs give to the same things, in lower case without "_" and "-". SLMaster's second
# camera has M2, R and T, and its projector M4, Rlp and Tlp; its S is the camera's width and height.
# One widely copied program misspells rotation.
_NAMES = {
    "camera_intrinsics": "cameraintrinsics camk camint cameramatrix1 cameramatrix k1 m1 kc kcam "
    "intrinsicscamera cameraintrinsic mtx1 kkleft",
    "projector_intrinsics": "projectorintrinsics projk projint m4 cameramatrix2 projectormatrix k2 "
    "m2 kp kproj intrinsicsprojector projectorintrinsic mtx2 kkright",
    # SLStudio has Kc and kc, which differ in their size only.
    "camera_distortion": "cameradistortion camkc camdist distcoeffs1 distcoeffs d1 dist1 distcam "
    "cameradistcoeffs cameradistortioncoefficients kc kcleft",
    "projector_distortion": "projectordistortion projkc projdist d4 distcoeffs2 d2 dist2 distproj "
    "projectordistcoeffs projectordistortioncoefficients kp kcright",
    "rotation": "rotation rlp rproj rp r rotationmatrix roration",
    "translation": "translation tlp tproj tp t tvec",
    # As rows and columns; as width and height; and one by one.
    "camera_shape": "camerashape imgshape",
    "projector_shape": "projectorshape",
    "camera_size": "camerasize cameraresolution camsize camres imagesize imagesize1 s",
    "projector_size": "projectorsize projectorresolution projsize projres imagesize2",
    "camera_width": "framewidth",
    "camera_height": "frameheight",
    "projector_width": "screenresx",
    "projector_height": "screenresy",
    "rms": "rms stereoerror stereorms rmsstereo",
}
_NEEDED = ("camera_intrinsics", "projector_intrinsics", "rotation", "translation")
# The names of ROS, as files of its calibrator and as messages of both versions.
_OF_ROS = {
    "K": ("camera_matrix", "K", "k"),
    "D": ("distortion_coefficients", "D", "d"),
    "R": ("rectification_matrix", "R", "r"),
    "P": ("projection_matrix", "P", "p"),
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
}


def read_rig(path: Path) -> Values:
    """What a file, or a folder of two files, states of a rig.

    Fields of `RigGeometry`, unchecked, or with "rotation" arguments of `from_intrinsics`, of which
    "camera_shape" and "projector_shape" may be missing.
    """
    files = [path]
    if path.is_dir():
        endings = (".yml", ".yaml", ".xml", ".json")
        files = sorted(each for each in path.iterdir() if each.suffix.lower() in endings)
        if len(files) != 2:
            raise InputError(
                f"{path}: holds {len(files)} files of a calibration",
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
    if start.startswith(b"MATLAB 5"):
        try:
            return dict(loadmat(file, simplify_cells=True))
        # Damaged files raise nearly anything.
        except Exception as error:
            raise InputError(f"{file}: is damaged", hint="save it again") from error
    if start in (b"MATLAB 7", b"\x89HDF\r\n\x1a\n"):
        raise InputError(f"{file}: is of MATLAB's version 7.3", hint="save it with the option -v7")
    text = read_text(file).strip()
    if text.startswith("{"):
        return dict(parse_json(text, str(file)))
    if text.startswith("<"):
        try:
            nodes = list(ElementTree.fromstring(text))
        except ElementTree.ParseError as error:
            hint = "is the file damaged?"
            raise InputError(f"{file}: cannot be read ({error})", hint=hint) from error
        parts = {
            each.tag: (each.findtext("data", each.text), each.findtext("rows")) for each in nodes
        }
        return {name: _numbers(text or "", rows) for name, (text, rows) in parts.items()}
    # The entries of YAML begin at the margin; what they hold is indented, or a list.
    values: Values = {}
    for entry in re.split(r"^(?=\w)", text, flags=re.MULTILINE):
        name, _, rest = entry.partition(":")
        rows = re.search(r"^\s*rows:\s*(\d+)", rest, flags=re.MULTILINE)
        values[name.strip()] = _numbers(rest.rpartition("data:")[2], rows and rows[1])
    return values


def _numbers(text: str, rows: str | None) -> NDArray[np.float64] | None:
    """The numbers of a text as an array of so many rows; None if there is anything else."""
    # Calibrations keep all corners beside their matrices, of which the largest is 4 x 4.
    words = [] if len(text) > 4000 else re.split(r"[\s,\[\]]+", text)
    return _array({"data": [word for word in words if word not in ("", "-")], "rows": rows or 1})


def _array(value: Any) -> NDArray[np.float64] | None:
    """A value as an array of numbers; None if it is anything else."""
    try:
        # OpenCV's matrices, in JSON.
        if isinstance(value, dict):
            value = np.reshape(np.array(value["data"], np.float64), (int(value["rows"]), -1))
        array = np.array(() if value is None else value, np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    return array if 0 < array.size <= 16 else None


# How each program's files are read: None if they are of another program.


def _ours(contents: Contents) -> Values | None:
    (file, content), *more = contents.items()
    if more or content.get("format") != GEOMETRY_FORMAT:
        return None
    check_version(file, content.get("version"), VERSION)
    return content


def _matlab(contents: Contents) -> Values | None:
    (file, content), *_ = contents.items()
    found = _group(content, "CameraParameters1")
    if found is None:
        return None
    values: Values = {}
    try:
        for number, device in ((1, "camera"), (2, "projector")):
            part = found[f"CameraParameters{number}"]
            # Older versions store K transposed, and R as well, for points as rows.
            matrix = np.array(part["K"] if "K" in part else np.transpose(part["IntrinsicMatrix"]))
            # MATLAB counts pixels from 1.
            values[f"{device}_intrinsics"] = matrix - [[0, 0, 1], [0, 0, 1], [0, 0, 0]]
            radial = np.ravel(part["RadialDistortion"])
            lens = (radial[:2], np.ravel(part["TangentialDistortion"]), radial[2:])
            values[f"{device}_distortion"] = np.concatenate(lens)
            if np.size(part.get("ImageSize", ())) == 2:
                values[f"{device}_shape"] = tuple(int(n) for n in np.ravel(part["ImageSize"]))
            units = str(part.get("WorldUnits") or "")
            short = {"millimeters": "mm", "centimeters": "cm", "meters": "m"}
            values["units"] = short.get(units, units) or None
        if "PoseCamera2" in found:
            pose = found["PoseCamera2"]
            return values | {"rotation": pose["R"], "translation": pose["Translation"]}
        turn = np.transpose(found["RotationOfCamera2"])
        return values | {"rotation": turn, "translation": found["TranslationOfCamera2"]}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{file}: its stereoParameters lack {error}",
            hint="save them with jsonencode(stereoParams), or toStruct(stereoParams) as .mat",
        ) from error


def _group(content: Any, name: str) -> Values | None:
    """The group that holds a name, in a group of groups."""
    if not isinstance(content, dict) or name in content:
        return content if isinstance(content, dict) else None
    return next((each for value in content.values() if (each := _group(value, name))), None)


def _ros(contents: Contents) -> Values | None:
    """A pair of camera_info: R and P lead from each device's frame to the one that both share."""
    devices = []
    for file, content in contents.items():
        info: Values = {
            name: each
            for name, keys in _OF_ROS.items()
            for key in keys
            if (each := _array(content.get(key))) is not None
        }
        if [np.size(info.get(name, ())) for name in "KRP"] != [9, 9, 12]:
            return None
        shared = np.reshape(info["P"], (3, 4))
        shift = np.linalg.solve(shared[:, :3], shared[:, 3])
        # The second device of a pair stands beside the origin.
        order = "proj" in file.name.lower(), float(np.abs(shift).max())
        devices.append((order, info, np.reshape(info["R"], (3, 3)), shift))
    if len(devices) != 2:
        hint = "put those of camera and projector into a folder, and give the folder"
        raise InputError(f"{next(iter(contents))}: is the camera_info of one device", hint=hint)
    devices.sort(key=lambda each: each[0])
    (_, _, one, origin), (_, _, other, beside) = devices
    values: Values = {"rotation": other.T @ one, "translation": other.T @ (beside - origin)}
    for device, (_, info, _, _) in zip(("camera", "projector"), devices, strict=True):
        values[f"{device}_intrinsics"] = np.reshape(info["K"], (3, 3))
        values[f"{device}_distortion"] = info.get("D", np.zeros(5))
        if {"width", "height"} <= set(info):
            values[f"{device}_shape"] = int(info["height"].item()), int(info["width"].item())
    return values


def _named(contents: Contents) -> Values | None:
    """Matrices by their names, in one file or in two."""
    plain: dict[str, list[NDArray[np.float64]]] = {}
    for name, value in (pair for content in contents.values() for pair in content.items()):
        if (array := _array(value)) is not None:
            plain.setdefault(re.sub("[_-]", "", name.lower()), []).append(array)
    found: Values = {}
    for name, others in _NAMES.items():
        fitting = [each for other in others.split() for each in plain.get(other, ())]
        # K has 3 x 3 numbers; a distortion that goes by the same name has not.
        if name.endswith(("intrinsics", "distortion")):
            lens = name.endswith("distortion")
            fitting = [each for each in fitting if (each.size == 9) != lens]
        if fitting:
            found[name] = fitting[0].reshape(3, 3) if fitting[0].size == 9 else fitting[0]
    missing = [name.replace("_", " ") for name in _NEEDED if name not in found]
    if len(missing) == len(_NEEDED):
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
        shape, size, *sides = (
            found.pop(f"{device}_{name}", None) for name in ("shape", "size", "height", "width")
        )
        if shape is None:
            sides = [*size.ravel()[::-1]] if size is not None else sides
            shape = np.array([np.nan if side is None else np.ravel(side)[0] for side in sides])
        # SLStudio states 0 for what it does not know.
        if shape.size == 2 and (shape > 0).all():
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
    if rig.projector_mirrored or (part.is_dir() and skew > 1e-6):
        what = "a mirrored projector" if rig.projector_mirrored else "skewed pixels"
        raise OutputError(f"this format cannot state {what}", hint="save it as .json")
    (_write_colmap if part.is_dir() else _write_opencv)(part, rig)


def _write_opencv(part: Path, rig: Any) -> None:
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
        x, y, z, w = Rotation.from_matrix(pose[:, :3]).as_quat()
        # The points that an image shows would stand in the line below.
        texts["images"] += (
            f"{number} {_spaced([w, x, y, z, *pose[:, 3]])} {number} {device}.png\n\n"
        )
    for name, text in texts.items():
        (part / f"{name}.txt").write_text(f"# {OUR_MARK}\n{text}", encoding="ascii")


def _spaced(numbers: list[Any]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
