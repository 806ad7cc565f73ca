"""Truth files: a light transport matrix that is known, with its direct part, as T.npz."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError
from lightmatrix.files.outputs import atomic_file
from lightmatrix.reprs import short_repr
from lightmatrix.transport.matrix import LightTransport

FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class Truth:
    """A known light transport matrix, direct and global light kept apart.

    Parameters
    ----------
    matrix : (M, N) csr_array float32
        The whole of T: camera full scale at exposure 1 per unit of projector pixel, >= 0.
    direct_data : (matrix.nnz,) float32
        The direct part of each stored entry, in [0, matrix.data].
    camera_shape : (rows, cols) or (rows, cols, channels)
    projector_shape : (rows, cols)
    metadata : mapping
        JSON-ready: scene, samples per pixel, seed, noise estimate, versions.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal")
    >>> 0 < known.direct_data.sum() < known.matrix.sum()
    np.True_
    >>> known.save("T.npz")
    >>> lm.truth("T.npz").camera_shape
    (64, 64)
    """

    matrix: csr_array
    direct_data: NDArray[np.float32]
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, int]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    @property
    def direct(self) -> csr_array:
        """The direct part: light that met one surface."""
        return self.with_data(self.direct_data)

    @property
    def indirect(self) -> csr_array:
        """The global part: light that met two surfaces or more."""
        return self.with_data(self.matrix.data - self.direct_data)

    def with_data(self, data: NDArray[Any]) -> csr_array:
        """A matrix with other values at the places of this one's entries."""
        return csr_array((data, self.matrix.indices, self.matrix.indptr), shape=self.matrix.shape)

    def transport(self) -> LightTransport:
        """The truth as a LightTransport without background."""
        return LightTransport.from_matrix(
            self.matrix, self.camera_shape, self.projector_shape, provenance=dict(self.metadata)
        )

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Write T.npz, which `scipy.sparse.load_npz` reads too; whole or not at all."""
        matrix = self.matrix
        with atomic_file(path, overwrite=overwrite) as temporary, open(temporary, "wb") as stream:
            np.savez_compressed(
                stream,
                format=np.array("csr").astype("S"),
                # scipy writes this key for arrays, as against matrices.
                _is_array=np.array(True),
                shape=np.array(matrix.shape),
                data=matrix.data,
                indices=matrix.indices,
                indptr=matrix.indptr,
                lightmatrix_truth=np.array(FORMAT_VERSION),
                camera_shape=np.array(self.camera_shape),
                projector_shape=np.array(self.projector_shape),
                direct_data=self.direct_data,
                metadata=np.array(json.dumps(dict(self.metadata))),
            )

    @classmethod
    def load(cls, path: Path) -> Truth:
        """Read a truth file.

        Raises
        ------
        InputError
            If the file is missing, is no npz, or lacks the shapes that lightmatrix adds.
        """
        if path.is_dir() or not path.exists():
            kind = "a folder" if path.is_dir() else "missing"
            raise InputError(
                f"{path} is {kind}", hint="give a T.npz file from `lightmatrix render`"
            )
        try:
            with open(path, "rb") as stream, np.load(stream) as file:
                content = {key: file[key] for key in file.files}
        except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise InputError(
                f"{path} cannot be read as npz: {error}",
                hint="give a T.npz file from `lightmatrix render` or `lightmatrix export`",
            ) from error
        needed = {"data", "indices", "indptr", "shape"}
        if not needed <= content.keys():
            lacking = ", ".join(sorted(needed - content.keys()))
            raise InputError(
                f"{path} holds no sparse matrix: {lacking} missing",
                hint="give a file that scipy.sparse.load_npz reads",
            )
        if "camera_shape" not in content or "projector_shape" not in content:
            raise InputError(
                f"{path} does not say the camera's and projector's shapes",
                hint="give a T.npz file from `lightmatrix render` or `lightmatrix export`",
            )
        if int(content.get("lightmatrix_truth", FORMAT_VERSION)) > FORMAT_VERSION:
            raise InputError(
                f"{path} has truth format {content['lightmatrix_truth']}, this version reads "
                f"{FORMAT_VERSION}",
                hint="install a newer lightmatrix",
            )
        if "background" in content and content["background"].any():
            raise InputError(
                f"{path} keeps its background apart, so its matrix is not the whole of T",
                hint="export it with --dense-background",
            )
        matrix = _checked_matrix(path, content)
        camera_shape = tuple(int(v) for v in content["camera_shape"])
        projector_shape = tuple(int(v) for v in content["projector_shape"])
        for what, shape, length in (
            ("camera", camera_shape, matrix.shape[0]),
            ("projector", projector_shape, matrix.shape[1]),
        ):
            if math.prod(shape) != length or min(shape) < 1:
                raise InputError(
                    f"{path} says its {what} has {' x '.join(map(str, shape))} pixels, its matrix "
                    f"has {length}",
                    hint="write it again with `lightmatrix render` or `lightmatrix export`",
                )
        direct = content.get("direct_data", np.zeros_like(matrix.data))
        if direct.shape != matrix.data.shape:
            raise InputError(
                f"{path} has {len(direct)} direct parts for {matrix.nnz} entries",
                hint="write it again with `lightmatrix render`",
            )
        return cls(
            matrix,
            direct.astype(np.float32),
            camera_shape,
            (projector_shape[0], projector_shape[1]),
            json.loads(str(content.get("metadata", "{}"))),
        )


def _checked_matrix(path: Path, content: Mapping[str, NDArray[Any]]) -> csr_array:
    data = content["data"].astype(np.float32)
    if not np.isfinite(data).all():
        raise InputError(
            f"{path} holds values that are not finite", hint="a truth has finite entries only"
        )
    try:
        rows, cols = (int(v) for v in content["shape"])
        matrix = csr_array((data, content["indices"], content["indptr"]), shape=(rows, cols))
        matrix.check_format(full_check=True)
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{path} contradicts itself: {error}", hint="the file is damaged; write it again"
        ) from error
    return matrix
