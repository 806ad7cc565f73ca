"""The light of one or several projectors in one camera, c = T1 p1 + T2 p2 + ...: one operator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.colours import colour_paths, holds_colour
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.loading import Transport, loaded

# Memory that a compensation takes, relative to the matrix. A megapixel camera with 29 entries a row
# and 64 values of background took 1.5 (python -m benchmarks.uses_at_scale).
_TIMES_ITS_SIZE = 1.5


@dataclass(frozen=True, eq=False)
class JointLight:
    """[T1 T2 ...] in single precision; patterns of all projectors are one vector, (N,)."""

    # One projector each, or one primary of a colour projector.
    matrices: tuple[LightTransport, ...]

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels)."""
        return self.matrices[0].camera_shape

    @property
    def pixels(self) -> int:
        """Projector pixels N of all projectors."""
        return sum(matrix.shape[1] for matrix in self.matrices)

    def check_single(self) -> None:
        """Raise an InputError if there is more than one projector or primary."""
        if len(self.matrices) > 1:
            raise InputError(
                f"{len(self.matrices)} matrices, for a use that takes one",
                hint="single pictures are compensated with several projectors, or in colour",
            )

    def split(self, light: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        """The patterns, (rows, cols) each, of a vector (N,)."""
        ends = np.cumsum([matrix.shape[1] for matrix in self.matrices])
        parts = np.split(light, ends[:-1])
        return tuple(
            part.reshape(matrix.projector_shape)
            for part, matrix in zip(parts, self.matrices, strict=True)
        )

    @cached_property
    def without_signs(self) -> JointLight:
        """The operator of the magnitudes of all entries; itself, unless T was estimated signed."""
        if all((m.sparse.data >= 0).all() and (m.background >= 0).all() for m in self.matrices):
            return self
        magnitudes = [
            replace(matrix, sparse=abs(matrix.sparse), background=abs(matrix.background))
            for matrix in self.matrices
        ]
        return JointLight(tuple(magnitudes))

    def forward(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """T p: camera samples (M,) of patterns (N,)."""
        result = np.zeros(self.matrices[0].shape[0], np.float32)
        for pattern, matrix in zip(self.split(light), self.matrices, strict=True):
            flat = pattern.ravel()
            result += matrix.sparse @ flat
            result += matrix.background @ (matrix.pooling @ flat)
        return result

    def adjoint(self, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """T' c: projector pixels (N,) of camera samples (M,)."""
        parts = [
            sparse @ samples + pooling @ (samples @ matrix.background)
            for (sparse, pooling), matrix in zip(self._transposed, self.matrices, strict=True)
        ]
        return np.concatenate(parts)

    @cached_property
    def white(self) -> NDArray[np.float32]:
        """The light of each camera sample under white of all projectors, (M,)."""
        return np.asarray(sum(self._whites))

    @cached_property
    def errors(self) -> NDArray[np.float32]:
        """Estimated relative error of what each camera sample sees under white, (M,).

        The errors of several matrices are independent. 0 where an estimate does not state one.
        """
        squares = np.zeros_like(self.white)
        for matrix, white in zip(self.matrices, self._whites, strict=True):
            stated = matrix.diagnostics.get("estimated_error")
            if stated is not None:
                squares += (np.nan_to_num(stated, nan=0.0).astype(np.float32) * white) ** 2
        relative = np.zeros_like(squares)
        return np.divide(np.sqrt(squares), self.white, out=relative, where=self.white > 0)

    @cached_property
    def _whites(self) -> list[NDArray[np.float32]]:
        """The light of each camera sample under white of each projector."""
        return [matrix @ np.ones(matrix.shape[1], np.float32) for matrix in self.matrices]

    @cached_property
    def _transposed(self) -> list[tuple[Any, Any]]:
        """Views of S' and m' of each projector, which share the arrays of S and m."""
        return [(matrix.sparse.T, matrix.pooling.T) for matrix in self.matrices]


def joint_light(transport: Transport | Sequence[Transport]) -> JointLight:
    """The operator of one matrix, or of several of one camera, loaded if they are on disk.

    The folder of a colour projector stands for the matrices of its primaries.
    An InputError says that they do not fit into memory, or that their cameras differ.
    """
    several = isinstance(transport, Sequence) and not isinstance(transport, str)
    sources: list[Any] = [*transport] if several else [transport]  # type: ignore[misc]
    if not sources:
        raise InputError("no light transport matrix", hint="give one, or one for each projector")
    parts = [part for source in sources for part in _primaries(source)]
    matrices = tuple(loaded(part, _TIMES_ITS_SIZE) for part in parts)
    shapes = sorted({matrix.camera_shape for matrix in matrices})
    if len(shapes) > 1:
        raise InputError(
            f"matrices of cameras of shapes {' and '.join(map(str, shapes))}",
            hint="give matrices that one camera measured, with the same binning",
        )
    return JointLight(matrices)


def _primaries(source: Any) -> Sequence[Any]:
    """The stores of the primaries in a colour projector's folder; else the source itself."""
    is_folder = isinstance(source, str | Path) and holds_colour(source)
    return colour_paths(source) if is_folder else (source,)
