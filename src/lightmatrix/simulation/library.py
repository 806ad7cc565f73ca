"""Where truths come from: bundled with the package, cached, or rendered on demand."""

from __future__ import annotations

import warnings
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import platformdirs

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.description import TRUTH
from lightmatrix.errors import InputError, LightMatrixWarning, OutputError
from lightmatrix.simulation.bundled_file import pack, unpack
from lightmatrix.simulation.procedural_capture import PROCEDURAL, truth_of
from lightmatrix.simulation.renderer import Progress, render
from lightmatrix.simulation.scenes import names, scene
from lightmatrix.simulation.truth import Truth

BUNDLED = ("l_objects", "gripper", "metal", "corner")
BUNDLED_SIZE = (64, 64)
BUNDLED_SAMPLES = 65_536
# Enough that the noise of the entries is a few per cent, in minutes rather than hours.
DEFAULT_SAMPLES = 16_384


def truth(
    name: str | Path | Truth,
    size: tuple[int, int] = BUNDLED_SIZE,
    *,
    samples: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Truth:
    """The light transport matrix of a scene: bundled, from the cache, or rendered and cached.

    Or that of a truth file, or of a capture that was simulated, wherever one is asked for.

    Parameters
    ----------
    name : str, Path or Truth
        A scene, which `scenes` lists; a truth file, T.npz; a capture with a truth.npz, packed or
        not, or of a procedural scene, whose truth is made again; or a truth, given back as it is.
    size : (rows, cols)
        Of a scene, camera and projector size. The bundled scenes come at 64 x 64.
    samples : int, optional
        Paths per camera pixel; None takes the bundled file, or 16,384 where there is none.
    seed : int
        Seed of the paths.
    progress : callable, optional
        Called with (done, total) paths where the scene is rendered.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        On an unknown scene, an impossible size, or a file that is no truth.
    MissingExtraError
        If it has to be rendered and Mitsuba is not installed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("corner")
    >>> known.matrix.shape, known.camera_shape
    ((4096, 4096), (64, 64))
    """
    if isinstance(name, Truth):
        return name
    if str(name).lower().endswith(".npz"):
        return Truth.load(Path(name))
    if Path(name).is_dir() and not (isinstance(name, str) and name in names()):
        return _beside(Path(name))
    name = str(name)
    described = scene(name)
    if name in BUNDLED and size == BUNDLED_SIZE and samples is None and seed == 0:
        with as_file(files("lightmatrix.simulation") / "data" / f"{name}.npz") as path:
            return unpack(path)
    samples = samples or DEFAULT_SAMPLES
    rows, cols = size
    key = f"{name}-v{described.version}-{rows}x{cols}-{samples}spp-seed{seed}.npz"
    path = cache_folder() / key
    if path.exists():
        try:
            return Truth.load(path)
        except InputError:
            pass  # damaged: rendered again below
    rendered = render(name, size, samples=samples, seed=seed, progress=progress)
    try:
        rendered.save(path, overwrite=True)
    except OutputError as error:
        warnings.warn(f"not cached: {error.message}", LightMatrixWarning, stacklevel=2)
    return rendered


def _beside(folder: Path) -> Truth:
    """The truth of a simulated capture: the file in it, or made again."""
    if (folder / TRUTH).is_file():
        return Truth.load(folder / TRUTH)
    found = truth_of(Capture.open(folder), folder)
    if found is None:
        raise InputError(
            f"{folder}: holds no {TRUTH}, and is of no {PROCEDURAL} scene",
            hint="give a T.npz file, a capture made by `lightmatrix simulate`, or a scene",
        )
    return found


class SceneSummary(NamedTuple):
    """A scene of the simulated rig: its name, what it shows, and whether it comes at 64 x 64."""

    name: str
    description: str
    bundled: bool


def scenes() -> tuple[SceneSummary, ...]:
    """The scenes of the simulated rig.

    Returns
    -------
    tuple of SceneSummary
        Name, description, and whether the scene is bundled at 64 x 64; others are rendered on
        first use and kept, which needs the extra `render`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> [scene.name for scene in lm.scenes() if scene.bundled]
    ['l_objects', 'gripper', 'metal', 'corner']
    """
    return tuple(SceneSummary(name, scene(name).description, name in BUNDLED) for name in names())


def cache_folder() -> Path:
    """Where rendered truths are kept: the user's cache directory, made on first use."""
    return Path(platformdirs.user_cache_dir("lightmatrix", appauthor=False)) / "truth"


def remake_bundled(folder: Path, *, progress: Progress | None = None) -> list[Path]:
    """Render the bundled truths again (``python -m lightmatrix.simulation.library FOLDER``)."""
    paths = []
    for name in BUNDLED:
        rendered = render(name, BUNDLED_SIZE, samples=BUNDLED_SAMPLES, progress=progress)
        paths.append(folder / f"{name}.npz")
        pack(paths[-1], rendered, overwrite=True)
    return paths


if __name__ == "__main__":
    import sys

    for made in remake_bundled(Path(sys.argv[1])):
        print(made, f"{made.stat().st_size / 2**20:.1f} MiB")
