"""Files of other programs: T as npz that SciPy loads or mat for MATLAB, and correspondences as npz.

`import_npz` reads exports and rendered truths.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files import kinds
from lightmatrix.files.extras import read_exr
from lightmatrix.files.images import read_image
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.files.reading import check_version, errors_naming, parse_json, regular_file
from lightmatrix.files.writing import atomic_file, check_output
from lightmatrix.paths import as_path
from lightmatrix.ranges import check_type, real_array
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.operator import HOW_TO_GIVE
from lightmatrix.transport.sparse_rows import checked_matrix, checked_shape

# The version of exports, truth files and correspondences. Files of another one are refused.
VERSION = 1
# Arrays of a correspondence for each camera pixel: type, and whether every file has them.
_MATCHES = {
    "pixel": (np.int32, True), "place": (np.float32, True), "confidence": (np.float32, True),
    "uncertainty": (np.float32, False), "light": (np.float32, False),
}  # fmt: skip


def export(
    path: str | Path,
    transport: LightTransport,
    *,
    dense_background: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a light transport matrix for SciPy (.npz) or MATLAB (.mat).

    An npz file holds T as CSR, as `scipy.sparse.load_npz` reads it. Extra keys hold the shapes, the
    background and the provenance, so that `open` returns the same LightTransport, except for the
    diagnostics. A mat file (level 5) holds a sparse double matrix ``T`` and the ``background``. In
    MATLAB, images are stored column by column: show row i as
    ``reshape(T(i, :), fliplr(projector_shape))'``.

    Parameters
    ----------
    path : str or Path
        Ends in .npz or .mat.
    transport : LightTransport
        What to write.
    dense_background : bool
        Spread the background over all entries, so that the matrix is the whole of T: exact, but up
        to M x N entries, 8 bytes each, not compressed. Otherwise the background is stored
        separately and the matrix is the sparse part alone.
    overwrite : bool
        Whether an existing export may be replaced.

    Raises
    ------
    OutputError
        If the file exists, ends otherwise, is too large for MATLAB's format, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.export("T_of_metal.npz", lm.truth("metal").transport())
    """
    check_type("a light transport matrix", transport, LightTransport, hint=HOW_TO_GIVE)
    kind = kinds.export_kind(path)
    check_output(path, kind, overwrite=overwrite)
    matrix, background = transport.sparse, transport.background
    if dense_background and background.any():
        matrix = transport.to_matrix(dense_background=True)
        background = np.zeros_like(background)
    shapes: dict[str, Any] = {
        "camera_shape": np.array(transport.camera_shape),
        "projector_shape": np.array(transport.projector_shape),
        "background_grid": np.array(transport.background_grid),
    }
    # MATLAB's level-5 files count the bytes of a variable in 32 bits.
    if kind is kinds.MAT and 8 * matrix.nnz >= 2**31:
        hint = "pass dense_background=False, or export to .npz"
        raise OutputError(f"{path}: {matrix.nnz} entries are too many for a .mat file", hint=hint)
    with atomic_file(path, kind, overwrite=overwrite) as part:
        if kind is kinds.MAT:
            # MATLAB only has sparse matrices of doubles, compressed by columns.
            content: dict[str, Any] = {
                "T": sparse.csc_array(matrix, dtype=np.float64),
                "background": background,
                **{name: shape.astype(np.float64) for name, shape in shapes.items()},
                "lightmatrix_version": float(VERSION),
            }
            scipy.io.savemat(part, content, appendmat=False, do_compression=True)
            with part.open("r+b") as written:
                # The file begins with 116 bytes of free text.
                written.write(kinds.MAT_MARK.encode().ljust(116))
            return
        # Dense entries hardly compress, and gigabytes of them take minutes.
        write = np.savez if dense_background else np.savez_compressed
        # NumPy would add its own ending to a name whose ending is in capitals.
        with part.open("wb") as stream:
            write(
                stream,
                # First, so that even a file that was cut off is recognized as ours.
                lightmatrix_transport=np.array(VERSION),
                **matrix_arrays(matrix),
                background=background,
                metadata=np.array(json.dumps(dict(transport.provenance), default=str)),
                **shapes,
            )


def matrix_arrays(matrix: sparse.csr_array) -> dict[str, Any]:
    """A CSR matrix as `scipy.sparse.load_npz` reads it; `_is_array` tells it from a csr_matrix."""
    parts = {name: getattr(matrix, name) for name in ("data", "indices", "indptr")}
    marks = {"format": np.array(b"csr"), "_is_array": np.array(True)}
    return marks | {"shape": np.array(matrix.shape)} | parts


def import_npz(path: str | Path) -> LightTransport:
    """Read T from npz: an export, a truth, or a CSR matrix of SciPy with the shapes beside it."""
    return read_transport(path)[0]


def read_transport(path: str | Path) -> tuple[LightTransport, dict[str, NDArray[Any]]]:
    """T of an npz file, and all arrays of the file."""
    file = as_path(path)
    content = read_npz(file)
    for name in (kinds.TRANSPORT_MARK, kinds.TRUTH_MARK):
        if name in content:
            _check_version(file, content[name])
    needed = ("format", "shape", "data", "indices", "indptr")
    if lacking := [name for name in needed if name not in content]:
        hint = "give a file from `lightmatrix export` or `render`"
        if kinds.CORRESPONDENCE_MARK in content:
            hint = "it says what each camera pixel sees: for `lightmatrix triangulate` and `map`"
        raise InputError(f"{file}: no sparse matrix: {', '.join(lacking)} missing", hint=hint)
    if not {"camera_shape", "projector_shape"} <= set(content):
        hint = "use lm.LightTransport.from_matrix(matrix, camera_shape, projector_shape)"
        raise InputError(f"{file}: does not say the shapes of camera and projector", hint=hint)
    try:
        if (form := text_of(content["format"])) != "csr":
            raise ValueError(f"a matrix in the form {form[:20]!r}; save it as csr (matrix.tocsr())")
        rows, cols = checked_shape(content["shape"], (2,), "the matrix", pixels=max)
        data, indices, indptr = (content[name] for name in needed[2:])
        matrix = checked_matrix(data, indices, indptr, (rows, cols))
        metadata: Any = {}
        if "metadata" in content:
            name = f"{file}: metadata"
            metadata = parse_json(text_of(content["metadata"]), name, finite=False)
        camera = checked_shape(content["camera_shape"], (2, 3), "camera_shape")
        tall, wide = checked_shape(content["projector_shape"], (2,), "projector_shape")
        grid = checked_shape(content.get("background_grid", np.ones(2, int)), (2,), "grid")
    except ValueError as error:
        hint = "the file is damaged; write it again"
        raise InputError(f"{file}: contradicts itself: {error}", hint=hint) from error
    background = content.get("background", np.zeros((rows, 1), np.float32))
    cells = (grid[0], grid[1])
    with errors_naming(file):
        transport = LightTransport(matrix, background, camera, (tall, wide), cells, {}, metadata)
    return transport, content


def _check_version(file: Path, stored: NDArray[Any]) -> None:
    check_version(file, stored.item() if stored.size == 1 else None, VERSION)


def text_of(value: NDArray[Any]) -> str:
    """The text of an array that holds a single value."""
    if value.size != 1:
        return "nothing"
    item = value.reshape(-1)[0].item()
    return item.decode("ascii", "replace") if isinstance(item, bytes) else str(item)


def write_correspondence(
    path: str | Path, matches: Correspondence, *, overwrite: bool = False
) -> None:
    """Write a correspondence as an npz file, which `read_correspondence` reads."""
    arrays = {name: getattr(matches, name) for name in _MATCHES}
    content: dict[str, Any] = {kinds.CORRESPONDENCE_MARK: np.array(VERSION)}
    content |= {name: array for name, array in arrays.items() if array is not None}
    if matches.projector_shape is not None:
        content["projector_shape"] = np.array(matches.projector_shape)
    with (
        atomic_file(path, kinds.CORRESPONDENCE, overwrite=overwrite) as temporary,
        open(temporary, "wb") as stream,
    ):
        # Fractions of pixels hardly compress, and it takes longer than decoding.
        np.savez(stream, **content)


def read_correspondence(path: str | Path) -> Correspondence:
    """Read a correspondence that `decode` wrote, or the map of another program.

    A map says which column x and row y of the projector, in pixels from 0, each camera pixel sees.
    What is negative or NaN is unknown, and 65535 or (0, 0) in integers.

    Parameters
    ----------
    path : str or Path
        The npz file of `decode`; one with the arrays x and y, (rows, cols) each; one of two images
        of 16 bits, NAME-x.png and NAME-y.png; or an EXR image with x in red and y in green.

    Returns
    -------
    Correspondence

    Raises
    ------
    InputError
        If the file is missing, damaged, of a later version, or no correspondence.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> code = lm.make_patterns("graycode", (64, 64), inverse=True)
    >>> _ = lm.decode(lm.simulate("metal", code, exposure=0.2), output="matches.npz")
    >>> lm.read_correspondence("matches.npz").projector_shape
    (64, 64)
    """
    file = as_path(path)
    if file.suffix.lower() != ".npz":
        return _map_of_images(file)
    content = read_npz(file)
    if {"x", "y"} <= set(content):
        with errors_naming(file):
            return _of_map(content["x"], content["y"])
    if kinds.CORRESPONDENCE_MARK not in content:
        hint = "give a file that `lightmatrix decode` wrote, or one with the arrays x and y"
        raise InputError(f"{file}: is no correspondence", hint=hint)
    _check_version(file, content[kinds.CORRESPONDENCE_MARK])
    shape = content.get("projector_shape")
    try:
        values: dict[str, Any] = {
            name: content[name] if needed else content.get(name)
            for name, (_, needed) in _MATCHES.items()
        }
        for name, (kind, _) in _MATCHES.items():
            if values[name] is not None and values[name].dtype != kind:
                raise ValueError(f"{name} is {values[name].dtype}")
        size = None if shape is None else (int(shape[0]), int(shape[1]))
        return Correspondence(**values, projector_shape=size)
    except (KeyError, IndexError, TypeError, ValueError, InputError) as error:
        words = error.message if isinstance(error, InputError) else str(error)
        hint = "make it again with `lightmatrix decode`"
        raise InputError(f"{file}: is damaged ({words})", hint=hint) from error


def _map_of_images(file: Path) -> Correspondence:
    """The map of an EXR image, or of the pair of images to which a file belongs."""
    if file.suffix.lower() == ".exr":
        channels = np.moveaxis(np.atleast_3d(read_exr(regular_file(file))), -1, 0)
        if len(channels) < 2:
            raise InputError(f"{file}: has one channel", hint="give x in red and y in green")
        x, y = channels[:2]
    else:
        name, axis = file.stem[:-1], file.stem[-1:]
        if axis not in tuple("xyXY"):
            hint = "name the images NAME-x.png and NAME-y.png, and give one of them"
            raise InputError(f"{file}: is no image of a pair", hint=hint)
        both = "XY" if axis.isupper() else "xy"
        x, y = (read_image(file.with_name(f"{name}{axis}{file.suffix}")) for axis in both)
        if x.dtype.itemsize == 1 or y.dtype.itemsize == 1:
            hint = "write pixels as 16 bits; 8 bits hold none beyond 255"
            raise InputError(f"{file}: is a map of 8 bits", hint=hint)
    with errors_naming(file):
        return _of_map(x, y)


def _of_map(x: NDArray[Any], y: NDArray[Any]) -> Correspondence:
    """A correspondence from the columns x and rows y, (rows, cols), that camera pixels see."""
    if np.ndim(x) != 2 or np.shape(x) != np.shape(y):
        hint = "give x and y as (rows, cols) of the camera, in projector pixels"
        raise InputError(f"x and y of shapes {np.shape(x)} and {np.shape(y)}", hint=hint)
    place = np.stack([real_array("y", y), real_array("x", x)], axis=-1).astype(np.float32)
    known = np.asarray(np.isfinite(place).all(axis=-1) & (place >= 0).all(axis=-1))
    if np.issubdtype(x.dtype, np.integer):
        known &= (place < 65535).all(axis=-1) & (place > 0).any(axis=-1)
    if not known.any():
        raise InputError("no camera pixel sees the projector", hint="is this the right file?")
    if not np.issubdtype(x.dtype, np.integer) and place[known].max() <= 1:
        raise InputError(
            "x and y lie between 0 and 1: they are shares of an image, as `map` writes, no pixels",
            hint="give T itself or the file of `decode`, or x and y in pixels of the projector",
        )
    place[~known] = np.nan
    pixel = np.where(known[..., None], np.rint(np.nan_to_num(place)), -1).astype(np.int32)
    return Correspondence(pixel, place, known.astype(np.float32))
