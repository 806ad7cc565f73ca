"""The kinds of outputs that lightmatrix writes, and how each is recognized.

A folder of ours carries a marker: a JSON object that holds the name of the format, the kind of the
output, and every file in it with its size. A folder without a marker, with a file that is not
listed, or with one of another size is not ours alone and is never replaced. A single file is
recognized by its content.

Kinds stand apart from the code that writes outputs, so that a command can check and lock its output
before it loads anything slow.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightmatrix.errors import OutputError
from lightmatrix.paths import as_path

MARKER, FORMAT = ".lightmatrix", "lightmatrix-output"
ANOTHER_NAME = "choose another name for the output"
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
# How a page of the viewer tells that it is one, within its first 1024 bytes.
PAGE_MARK = '<meta name="generator" content="lightmatrix viewer">'
# How an MPCDI file tells that it is ours: the name of its first member.
MPCDI_MARK = "lightmatrix.pfm"
# How point clouds and geometries of other programs tell that they are ours, in a comment.
OUR_MARK = "written by lightmatrix"
RIG_FORMAT, RESPONSE_FORMAT = "lightmatrix-rig", "lightmatrix-response"
GEOMETRY_FORMAT = "lightmatrix-geometry"
# The first bytes of PNG, npy, TIFF and EXR files.
_IMAGES = (b"\x89PNG\r\n\x1a\n", b"\x93NUMPY", b"II*\0", b"MM\0*", b"v/1\x01")


@dataclass(frozen=True)
class FolderKind:
    """A kind of output that is a folder."""

    # In words, such as "capture"; stands in the marker.
    name: str
    # Permitted endings, in lower case; empty permits any.
    suffixes: tuple[str, ...] = ()
    # Ending of the folder beside the output for its running results; empty if none.
    running: str = ""

    @property
    def marker_file(self) -> str:
        """The file with the marker: an attribute in Zarr, which warns of files not its own."""
        return "zarr.json" if ".zarr" in self.suffixes else MARKER

    def check_replaceable(self, shown: Path, target: Path) -> bool:
        """Whether a folder of ours may be replaced; False if it is just empty."""
        if not target.is_dir():
            raise OutputError(
                f"{shown}: is a file, the output is a folder ({self.name})", hint=ANOTHER_NAME
            )
        if not any(target.iterdir()):
            return False
        marker = _read_marker(target)
        if marker is None:
            raise OutputError(
                f"{shown}: is a folder that was not written by lightmatrix",
                hint=f"{ANOTHER_NAME}, or remove the folder yourself",
            )
        if marker["kind"] != self.name:
            raise OutputError(
                f"{shown}: holds a {printable(str(marker['kind']))}, the output is a {self.name}",
                hint=f"{ANOTHER_NAME}, or remove the folder yourself",
            )
        files = marker["files"]
        for name, size in _sizes_below(target):
            if name == self.marker_file or files.get(name) == size:
                continue
            problem = f"holds {printable(name)}, which was not written by lightmatrix"
            if name in files:
                problem = f"{printable(name)} in it was changed since lightmatrix wrote it"
            hint = f"{ANOTHER_NAME}, or move that file elsewhere"
            raise OutputError(f"{shown}: {problem}", hint=hint)
        return True

    def mark(self, folder: Path) -> None:
        """Write the marker of a finished folder."""
        files = {name: size for name, size in _sizes_below(folder) if name != self.marker_file}
        content: dict[str, Any] = {"format": FORMAT, "kind": self.name, "files": files}
        file = folder / self.marker_file
        if self.marker_file != MARKER:
            group = json.loads(file.read_text(encoding="utf-8"))
            group["attributes"]["output"] = content
            content = group
        # In one step, since a folder that is in use may be marked again.
        written = file.with_name(f"{file.name}.new")
        written.write_text(json.dumps(content, indent=1) + "\n")
        os.replace(written, file)


@dataclass(frozen=True)
class FileKind:
    """A kind of output that is one file."""

    name: str
    suffixes: tuple[str, ...]
    # What stands in its first 1024 bytes, or one of the signatures that it begins with.
    mark: str | tuple[bytes, ...]
    running: str = ""

    def recognize(self, file: Path) -> bool:
        """Whether a file is of this kind by its content; files may be cut off."""
        with file.open("rb") as opened:
            start = opened.read(1024)
        if isinstance(self.mark, str):
            # Bare coordinates have no place for a mark.
            return self.mark.encode() in start or file.suffix.lower() == ".xyz"
        return start.startswith(self.mark)

    def check_replaceable(self, shown: Path, target: Path) -> bool:
        """Whether a file may be replaced: True, or OutputError if it is of another kind."""
        if target.is_dir():
            raise OutputError(
                f"{shown}: is a folder, the output is a file ({self.name})", hint=ANOTHER_NAME
            )
        if target.stat().st_size == 0:
            return True
        if not self.recognize(target):
            raise OutputError(
                f"{shown}: is a file that was not written by lightmatrix as {self.name}",
                hint=f"{ANOTHER_NAME}, or remove the file yourself",
            )
        return True


OutputKind = FolderKind | FileKind


def read_object(file: Path) -> dict[str, Any] | None:
    """A JSON object from a file that may be anything; None if it holds none."""
    try:
        # Far more bytes than any marker takes.
        if file.is_symlink() or not file.is_file() or file.stat().st_size > 1 << 28:
            return None
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def printable(text: str) -> str:
    """A name without characters that would disturb a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _read_marker(folder: Path) -> dict[str, Any] | None:
    """The marker of a folder, with "kind" and "files"; None without our marker."""
    group = (read_object(folder / "zarr.json") or {}).get("attributes")
    for content in (
        read_object(folder / MARKER),
        group.get("output") if isinstance(group, dict) else None,
    ):
        if (
            isinstance(content, dict)
            and content.get("format") == FORMAT
            and "kind" in content
            and isinstance(content.get("files"), dict)
        ):
            return content
    return None


def _sizes_below(folder: Path) -> Iterator[tuple[str, int]]:
    """Path and size of all but folders in a folder; -1 for links, pipes, devices and mounts."""

    def fail(error: OSError) -> None:
        raise error

    for place, folders, files in os.walk(folder, onerror=fail):
        folders.sort()
        inner = Path(place)
        special = [
            name for name in folders if (inner / name).is_symlink() or os.path.ismount(inner / name)
        ]
        for name in sorted([*files, *special]):
            path = inner / name
            regular = path.is_file() and not path.is_symlink()
            yield path.relative_to(folder).as_posix(), path.stat().st_size if regular else -1


PATTERNS = FolderKind("folder of patterns")
CAPTURE = FolderKind("capture")
# A capture that is being photographed, perhaps for hours, keeps its frames as running results.
LIVE_CAPTURE = FolderKind("capture", running=PARTIAL)
STORE = FolderKind("light transport matrix", (".zarr",), running=PARTIAL)
COLOUR_STORES = FolderKind("light transport matrix of a colour projector")
PROJECTOR_STORES = FolderKind("light transport matrices of several projectors", running=PARTIAL)
SEPARATION = FolderKind("separation")
DEMO = FolderKind("demo report")
REPORT = FolderKind("report")
TRUTH = FileKind("rendered matrix", (".npz",), f"{TRUTH_MARK}.npy")
PACKED = FileKind("packed scene", (".npz",), f"{PACKED_MARK}.npy")
NUMBERS = FileKind("numbers of a picture", (".npz",), f"{NUMBERS_MARK}.npy")
RIG = FileKind("measurements of a rig", (".json",), f'"format": "{RIG_FORMAT}"')
RESPONSE = FileKind("measured response", (".json",), f'"format": "{RESPONSE_FORMAT}"')
# Those of other programs have kinds of their own, below; messages name the endings of all.
GEOMETRY = FileKind(
    "geometry of a rig", (".json", ".yml", ".xml", ".colmap"), f'"format": "{GEOMETRY_FORMAT}"'
)
OPENCV_GEOMETRY = FileKind("geometry of a rig", (".yml", ".yaml", ".xml"), OUR_MARK)
COLMAP = FolderKind("geometry of a rig", (".colmap",))
PAGE = FileKind("page of the viewer", (".html",), PAGE_MARK)
CORRESPONDENCE = FileKind("correspondence", (".npz",), f"{CORRESPONDENCE_MARK}.npy")
MAP_FOLDER = FolderKind("projector map")
MPCDI = FileKind("MPCDI file", (".mpcdi",), MPCDI_MARK)
CLOUD = FileKind("point cloud", (".ply", ".obj", ".pcd", ".xyz"), OUR_MARK)
# Depth maps do not say who wrote them, like images.
DEPTH = FileKind("depth map", (".tif", ".tiff", ".npy", ".png"), _IMAGES)
NPZ = FileKind("exported matrix", (".npz",), f"{TRANSPORT_MARK}.npy")
MAT = FileKind("exported matrix", (".mat",), MAT_MARK)
# Images do not say who wrote them, so any image may be replaced by another.
IMAGE = FileKind("image", (".png", ".tif", ".tiff", ".npy", ".exr"), _IMAGES)
PICTURE = FileKind("picture", (".png",), _IMAGES[:1])


def geometry_kind(path: str | Path) -> FileKind | FolderKind:
    """The kind of geometry that is written at a path, by its ending."""
    suffix = as_path(path).suffix.lower()
    return next((kind for kind in (OPENCV_GEOMETRY, COLMAP) if suffix in kind.suffixes), GEOMETRY)


def export_kind(path: str | Path) -> FileKind:
    """The kind of file that `export` writes at a path: npz or mat, by its ending."""
    suffix = as_path(path).suffix
    for kind in (NPZ, MAT):
        if suffix.lower() in kind.suffixes:
            return kind
    hint = "end it in .npz or .mat"
    raise OutputError(f"{path}: the name of the output ends in {suffix or 'nothing'}", hint=hint)
