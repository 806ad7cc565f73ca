"""The kinds of outputs that lightmatrix writes, each known again by what is inside it.

They stand here together, apart from what writes them, so that a command can judge and lock its
output before anything slow is loaded.
"""

from __future__ import annotations

from pathlib import Path

from lightmatrix.errors import OutputError
from lightmatrix.outputs.markers import FileKind, FolderKind, holds_member, read_object

# Endings of the folders that hold running results, beside an output.
PARTIAL, CASES = ".partial", ".cases"
# What the members are called by which our npz files are known.
TRANSPORT_MARK, TRUTH_MARK, PACKED_MARK, NUMBERS_MARK = (
    "lightmatrix_transport",
    "lightmatrix_truth",
    "lightmatrix_packed",
    "lightmatrix_numbers",
)
# The text that our mat files begin with; readers of the format pass over it.
MAT_MARK = "MATLAB 5.0 MAT-file, written by lightmatrix"
RIG_FORMAT, RESPONSE_FORMAT = "lightmatrix-rig", "lightmatrix-response"
_IMAGES = (b"\x89PNG\r\n\x1a\n", b"\x93NUMPY", b"II*\0", b"MM\0*", b"v/1\x01")


def _begins_with(file: Path, *starts: bytes) -> bool:
    with file.open("rb") as opened:
        return opened.read(max(map(len, starts))).startswith(starts)


def _is_json(file: Path, name: str) -> bool:
    content = read_object(file)
    return content is not None and content.get("format") == name


PATTERNS = FolderKind("folder of patterns")
CAPTURE = FolderKind("capture")
# The same, photographed: frame by frame, over hours perhaps.
LIVE_CAPTURE = FolderKind("capture", running=PARTIAL)
# The marker is an attribute of the group, since Zarr warns of files that are none of its own.
STORE = FolderKind(
    "light transport matrix", (".zarr",), ("zarr.json", "attributes", "output"), running=PARTIAL
)
PACKED_CAPTURE = FolderKind("packed capture", (".zarr",), ("zarr.json", "attributes", "output"))
PICTURES = FolderKind("folder of pictures")
THUMBNAILS = FolderKind("folder of scene pictures")
DEMO = FolderKind("demo report")
REPORT = FolderKind("report")
FIGURE = FolderKind("figure", running=CASES)
TRUTH = FileKind("rendered matrix", (".npz",), lambda file: holds_member(file, TRUTH_MARK))
PACKED = FileKind("packed scene", (".npz",), lambda file: holds_member(file, PACKED_MARK))
NUMBERS = FileKind("numbers of a picture", (".npz",), lambda file: holds_member(file, NUMBERS_MARK))
RIG = FileKind("measurements of a rig", (".json",), lambda file: _is_json(file, RIG_FORMAT))
RESPONSE = FileKind("measured response", (".json",), lambda file: _is_json(file, RESPONSE_FORMAT))
NPZ = FileKind("exported matrix", (".npz",), lambda file: holds_member(file, TRANSPORT_MARK))
MAT = FileKind("exported matrix", (".mat",), lambda file: _begins_with(file, MAT_MARK.encode()))
# Images say nothing of who wrote them: one may take the place of another.
IMAGE = FileKind(
    "image", (".png", ".tif", ".tiff", ".npy", ".exr"), lambda file: _begins_with(file, *_IMAGES)
)
PICTURE = FileKind("picture", (".png",), lambda file: _begins_with(file, _IMAGES[0]))


def export_kind(path: str | Path) -> FileKind:
    """The kind of file that `export` writes at a path, by its ending.

    Raises
    ------
    OutputError
        If it ends neither in .npz nor in .mat.
    """
    suffix = Path(path).suffix
    for kind in (NPZ, MAT):
        if suffix.lower() in kind.suffixes:
            return kind
    raise OutputError(
        f"{path}: the name of the output ends in {suffix or 'nothing'}",
        hint="end it in .npz or .mat",
    )
