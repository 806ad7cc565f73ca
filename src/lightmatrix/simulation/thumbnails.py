"""`lm.write_thumbnails`: a small picture of every scene under white projector light."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import MissingExtraError
from lightmatrix.files.images import fill_image
from lightmatrix.files.kinds import THUMBNAILS
from lightmatrix.files.writing import atomic_folder
from lightmatrix.simulation import library
from lightmatrix.simulation.mitsuba_scene import load_mitsuba, mitsuba_scene
from lightmatrix.simulation.scenes import names, scene

# The picture of a scene shows this multiple of this quantile of its image as white, so that a few
# highlights do not make everything else dark. Chosen by eye on the bundled scenes.
_WHITE_FACTOR, _WHITE_QUANTILE = 1.1, 0.97


def white_image(
    name: str, shape: tuple[int, int], *, samples: int = 128, seed: int = 0
) -> NDArray[np.float32]:
    """The linear camera image (rows, cols) of a scene under a white pattern, path traced."""
    mi, _ = load_mitsuba()
    image = mi.render(mitsuba_scene(mi, scene(name), shape, shape), spp=samples, seed=seed)
    return np.asarray(image, np.float32).mean(axis=2)


def white_level(image: NDArray[np.float32]) -> float:
    """The value of a linear image that a picture shows as white."""
    return float(_WHITE_FACTOR * np.quantile(image, _WHITE_QUANTILE))


def write_thumbnails(
    folder: str | Path,
    *,
    size: tuple[int, int] = (256, 256),
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write NAME.png for every scene and a list, scenes.json.

    Without the renderer, only the bundled scenes are drawn, from their matrices at 64 x 64.

    Parameters
    ----------
    folder : str or Path
        The folder to make.
    size : (rows, cols)
        Size of the pictures.
    overwrite : bool
        Whether an existing folder of thumbnails may be replaced.
    progress : callable, optional
        Called with (done, total) scenes.

    Returns
    -------
    list of Path
        The pictures.

    Raises
    ------
    OutputError
        If the folder exists, holds something else, or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> paths = lm.write_thumbnails("thumbnails")  # doctest: +SKIP
    """
    written = []
    with atomic_folder(folder, THUMBNAILS, overwrite=overwrite) as temporary:
        for done, name in enumerate(names(), start=1):
            try:
                image = white_image(name, size)
            except MissingExtraError:
                if name not in library.BUNDLED:
                    continue
                known = library.truth(name)
                image = np.asarray(known.matrix.sum(axis=1), np.float32).reshape(known.camera_shape)
            shown = np.clip(image / white_level(image), 0, 1) ** (1 / 2.2)
            fill_image(temporary / f"{name}.png", shown.astype(np.float32))
            written.append(Path(folder) / f"{name}.png")
            if progress is not None:
                progress(done, len(names()))
        descriptions = {path.stem: scene(path.stem).description for path in written}
        (temporary / "scenes.json").write_text(json.dumps(descriptions, indent=2) + "\n")
    return written
