"""Patterns that a use has found, written as images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.files.images import write_image
from lightmatrix.outputs.kinds import IMAGE
from lightmatrix.outputs.writing import check_output


def write_shown(
    output: str | Path, patterns: Sequence[NDArray[np.float32]], *, overwrite: bool = False
) -> list[Path]:
    """Write patterns as images: one, three in colour, or several with numbers."""
    path = Path(output)
    if len(patterns) == 3 and len({pattern.shape for pattern in patterns}) == 1:
        images = {path: np.stack(patterns, axis=-1)}
    elif len(patterns) == 1:
        images = {path: patterns[0]}
    else:
        names = [path.with_name(f"{path.stem}-{k}{path.suffix}") for k, _ in enumerate(patterns, 1)]
        images = dict(zip(names, patterns, strict=True))
    for place in images:
        check_output(place, IMAGE, overwrite=overwrite)
    for place, image in images.items():
        write_image(place, image, overwrite=overwrite)
    return list(images)
