"""Files of a rig's geometry: our own, in JSON, and those of OpenCV's FileStorage."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.extras import load_opencv
from lightmatrix.files.json_files import parse_json, read_json
from lightmatrix.files.reading import read_text
from lightmatrix.outputs.kinds import GEOMETRY, GEOMETRY_FORMAT
from lightmatrix.outputs.writing import atomic_file

VERSION = 1
Shape = tuple[int, int]
# Names that calibration programs give to the same things, in lower case without "_" and "-". The
# first of a line is ours.
_NAMES = {
    "camera_intrinsics": "cameraintrinsics camk camint cameramatrix1 cameramatrix k1 m1 kc kcam "
    "intrinsicscamera cameraintrinsic mtx1 ",
    "projector_intrinsics": "projectorintrinsics projk projint cameramatrix2 projectormatrix k2 m2 "
    "kp kproj intrinsicsprojector projectorintrinsic mtx2",
    "camera_distortion": "cameradistortion camkc camdist distcoeffs1 distcoeffs d1 dist1 distcam "
    "cameradistcoeffs cameradistortioncoefficients",
    "projector_distortion": "projectordistortion projkc projdist distcoeffs2 d2 dist2 distproj "
    "projectordistcoeffs projectordistortioncoefficients",
    # One widely copied program misspells it.
    "rotation": "rotation r rproj rotationmatrix roration",
    "translation": "translation t tproj tvec",
    "camera_shape": "camerashape",
    "projector_shape": "projectorshape",
    "camera_size": "camerasize cameraresolution camsize camres imagesize imagesize1",
    "projector_size": "projectorsize projectorresolution projsize projres imagesize2",
    "rms": "rms stereoerror stereorms rmsstereo",
}
_NEEDED = ("camera_intrinsics", "projector_intrinsics", "rotation", "translation")
_FIELDS = {
    "camera_matrix",
    "projector_matrix",
    "camera_shape",
    "projector_shape",
    "camera_distortion",
    "projector_distortion",
    "units",
    "rms",
}


def write_geometry(path: Path, content: dict[str, Any], *, overwrite: bool) -> None:
    """Write the fields of a geometry as a JSON file."""
    whole = {"format": GEOMETRY_FORMAT, "version": VERSION, **content}
    with atomic_file(path, GEOMETRY, overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")


def read_geometry(
    file: Path, camera_shape: Shape | None, projector_shape: Shape | None
) -> dict[str, Any]:
    """Arguments of `RigGeometry`, or with "rotation" those of `from_intrinsics`."""
    text = read_text(file)
    start = text.lstrip()[:64]
    if start.startswith("{") and "opencv-matrix" not in text:
        content = parse_json(text, str(file))
        if not (isinstance(content, dict) and not content.get("format") and _known(content)):
            return _own(file)
        values = {name: _array(value) for name, value in content.items()}
    elif start.startswith(("<?xml", "<opencv_storage", "%YAML", "---", "{")):
        values = _opencv_values(file, text)
    else:
        raise _not_a_geometry(file)
    return _arguments(file, values, camera_shape, projector_shape)


def _own(file: Path) -> dict[str, Any]:
    """The fields in a file of our own."""
    return checked_fields(read_json(file, GEOMETRY_FORMAT, VERSION), str(file))


def checked_fields(content: Any, file: str) -> dict[str, Any]:
    """The fields of a geometry in an object of JSON, in which others are ignored."""
    if not isinstance(content, dict):
        raise InputError(f"{file}: holds no geometry of a rig", hint="write it again")
    fields = {name: value for name, value in content.items() if name in _FIELDS}
    missing = sorted(_FIELDS - {"units", "rms"} - set(fields))
    if missing:
        raise InputError(
            f"{file}: lacks {', '.join(missing)}",
            hint="write it again with `lightmatrix calibrate`",
        )
    units, rms = fields.get("units"), fields.get("rms", {})
    if not isinstance(units, str | None) or not _is_numbers(rms):
        raise InputError(
            f'{file}: "units" is no text, or "rms" holds no numbers',
            hint="write it again with `lightmatrix calibrate`",
        )
    return fields


def _is_numbers(rms: Any) -> bool:
    """Whether this is an object whose values are numbers."""
    return isinstance(rms, dict) and all(type(value) in (int, float) for value in rms.values())


def _not_a_geometry(file: Path) -> InputError:
    return InputError(
        f"{file}: holds no geometry of a rig",
        hint="give a file of `lightmatrix calibrate`, or of OpenCV with camera and projector "
        "matrices, R and T",
    )


def _plain(name: str) -> str:
    return name.lower().replace("_", "").replace("-", "")


def _known(content: dict[str, Any]) -> bool:
    """Whether an object of JSON names at least one thing that a calibration holds."""
    known = " ".join(_NAMES.values()).split()
    return any(_plain(name) in known for name in content)


def _array(value: Any) -> NDArray[Any] | None:
    """A value as an array, or None if it holds anything but numbers."""
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.size else None


def _opencv_values(file: Path, text: str) -> dict[str, NDArray[Any] | None]:
    """All matrices and numbers at the top of a file of OpenCV's FileStorage."""
    cv2 = load_opencv(f"{file}: a file of OpenCV", "shape")
    values: dict[str, NDArray[Any] | None] = {}
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        for name in root.keys():  # noqa: SIM118 (a FileNode is no dict)
            node = root.getNode(name)
            if node.isReal() or node.isInt():
                values[name] = _array(node.real())
            elif node.isSeq():
                values[name] = _array([node.at(k).real() for k in range(node.size())])
            elif node.isMap():
                values[name] = _array(node.mat())
        storage.release()
    except (cv2.error, SystemError, UnicodeError, TypeError) as error:
        raise InputError(f"{file}: OpenCV cannot read it", hint="is the file damaged?") from error
    return values


def _arguments(
    file: Path,
    values: dict[str, NDArray[Any] | None],
    camera_shape: Shape | None,
    projector_shape: Shape | None,
) -> dict[str, Any]:
    """Arguments of `from_intrinsics` from the values of a calibration program."""
    plain = {_plain(name): value for name, value in values.items()}
    found: dict[str, Any] = {}
    for name, others in _NAMES.items():
        fitting = [plain[other] for other in others.split() if plain.get(other) is not None]
        if fitting:
            found[name] = fitting[0]
    missing = [name.replace("_", " ") for name in _NEEDED if name not in found]
    if len(missing) == len(_NEEDED):
        raise _not_a_geometry(file)
    if missing:
        raise InputError(
            f"{file}: names no {' and no '.join(missing)}",
            hint="name the matrices cam_K, proj_K, R and T, and the distortions cam_kc and proj_kc",
        )
    rms = found.pop("rms", None)
    if rms is not None and rms.size == 1:
        found["rms"] = {"stereo": float(rms.ravel()[0])}
    for device, given in (("camera", camera_shape), ("projector", projector_shape)):
        # OpenCV states a size as width and height.
        size = found.pop(f"{device}_size", None)
        stated = found.get(f"{device}_shape", None if size is None else size.ravel()[::-1])
        if stated is None and given is None:
            raise InputError(
                f"{file}: does not state the image size of the {device}",
                hint=f"give {device}_shape, or write {device}_size: width, height into the file",
            )
        found[f"{device}_shape"] = given if stated is None else tuple(map(int, stated.ravel()))
    return found
