"""The kinds of outputs that lightmatrix writes, and how each is recognized.

They stand apart from the code that writes them, so that a command can check and lock its output
before it loads anything slow.
"""

from __future__ import annotations

from pathlib import Path

from lightmatrix.errors import OutputError
from lightmatrix.outputs.markers import FileKind, FolderKind, holds_member, read_object

# Ending of the folder beside an output that holds its running results.
PARTIAL = ".partial"
# Names of the arrays by which our npz files are recognized.
TRANSPORT_MARK, TRUTH_MARK, PACKED_MARK, NUMBERS_MARK, CORRESPONDENCE_MARK = (
    "lightmatrix_transport",
    "lightmatrix_truth",
    "lightmatrix_packed",
    "lightmatrix_numbers",
    "lightmatrix_correspondence",
)
# The text with which our mat files begin; readers of the format ignore it.
MAT_MARK = "MATLAB 5.0 MAT-file, written by lightmatrix"
# How a page of the viewer tells that it is one, within its first bytes.
PAGE_MARK = '<meta name="generator" content="lightmatrix viewer">'
_EARLY = 1024
# How a point cloud tells that it is ours, in its header.
PLY_MARK = "comment written by lightmatrix"
RIG_FORMAT, RESPONSE_FORMAT = "lightmatrix-rig", "lightmatrix-response"
GEOMETRY_FORMAT = "lightmatrix-geometry"
# The first bytes of PNG, npy, TIFF and EXR files.
_IMAGES = (b"\x89PNG\r\n\x1a\n", b"\x93NUMPY", b"II*\0", b"MM\0*", b"v/1\x01")


def _begins_with(file: Path, *starts: bytes) -> bool:
    with file.open("rb") as opened:
        return opened.read(max(map(len, starts))).startswith(starts)


def _holds_early(file: Path, mark: str) -> bool:
    with file.open("rb") as opened:
        return mark.encode() in opened.read(_EARLY)


def _is_json(file: Path, name: str) -> bool:
    content = read_object(file)
    return content is not None and content.get("format") == name


PATTERNS = FolderKind("folder of patterns")
CAPTURE = FolderKind("capture")
# A capture that is being photographed, perhaps for hours, keeps its frames as running results.
LIVE_CAPTURE = FolderKind("capture", running=PARTIAL)
# The marker is an attribute of the group, since Zarr warns of files that are not its own.
STORE = FolderKind(
    "light transport matrix", (".zarr",), ("zarr.json", "attributes", "output"), running=PARTIAL
)
COLOUR_STORES = FolderKind("light transport matrix of a colour projector")
PACKED_CAPTURE = FolderKind("packed capture", (".zarr",), ("zarr.json", "attributes", "output"))
PICTURES = FolderKind("folder of pictures")
SEPARATION = FolderKind("separation")
THUMBNAILS = FolderKind("folder of scene pictures")
DEMO = FolderKind("demo report")
REPORT = FolderKind("report")
TRUTH = FileKind("rendered matrix", (".npz",), lambda file: holds_member(file, TRUTH_MARK))
PACKED = FileKind("packed scene", (".npz",), lambda file: holds_member(file, PACKED_MARK))
NUMBERS = FileKind("numbers of a picture", (".npz",), lambda file: holds_member(file, NUMBERS_MARK))
RIG = FileKind("measurements of a rig", (".json",), lambda file: _is_json(file, RIG_FORMAT))
RESPONSE = FileKind("measured response", (".json",), lambda file: _is_json(file, RESPONSE_FORMAT))
GEOMETRY = FileKind("geometry of a rig", (".json",), lambda file: _is_json(file, GEOMETRY_FORMAT))
PAGE = FileKind("page of the viewer", (".html",), lambda file: _holds_early(file, PAGE_MARK))
CORRESPONDENCE = FileKind(
    "correspondence", (".npz",), lambda file: holds_member(file, CORRESPONDENCE_MARK)
)
CLOUD = FileKind("point cloud", (".ply",), lambda file: _holds_early(file, PLY_MARK))
# Depth maps do not say who wrote them, like images.
DEPTH = FileKind("depth map", (".tif", ".tiff", ".npy"), lambda file: _begins_with(file, *_IMAGES))
NPZ = FileKind("exported matrix", (".npz",), lambda file: holds_member(file, TRANSPORT_MARK))
MAT = FileKind("exported matrix", (".mat",), lambda file: _begins_with(file, MAT_MARK.encode()))
# Images do not say who wrote them, so any image may be replaced by another.
IMAGE = FileKind(
    "image", (".png", ".tif", ".tiff", ".npy", ".exr"), lambda file: _begins_with(file, *_IMAGES)
)
PICTURE = FileKind("picture", (".png",), lambda file: _begins_with(file, _IMAGES[0]))


def export_kind(path: str | Path) -> FileKind:
    """The kind of file that `export` writes at a path: npz or mat, by its ending."""
    suffix = Path(path).suffix
    for kind in (NPZ, MAT):
        if suffix.lower() in kind.suffixes:
            return kind
    raise OutputError(
        f"{path}: the name of the output ends in {suffix or 'nothing'}",
        hint="end it in .npz or .mat",
    )
