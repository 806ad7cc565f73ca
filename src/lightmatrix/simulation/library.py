"""`lm.truth`, `lm.scenes`: truths bundled, cached, or rendered on demand."""

import json
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import platformdirs
from scipy.sparse import csr_array

from lightmatrix.capture.settings import TRUTH
from lightmatrix.defaults import PROCEDURAL, USUAL_SAMPLES
from lightmatrix.errors import InputError, OutputError, warn
from lightmatrix.files.numpy_files import read_npz
from lightmatrix.paths import as_path
from lightmatrix.progress import Progress
from lightmatrix.simulation.procedural import ProceduralScene
from lightmatrix.simulation.renderer import render
from lightmatrix.simulation.scenes import Scene, names, scene, seen_by
from lightmatrix.simulation.truth import Truth, view_geometry


def read_bundled(path: Path) -> Truth:
    """Read a file of `tools/bundled_scenes.py`."""
    content = read_npz(path)
    sums = content["sums"].astype(np.float64)
    rows, cols = (int(v) for v in content["projector_shape"])
    shape = (len(sums), rows * cols)
    mask = np.unpackbits(content["mask"], count=shape[0] * shape[1]).view(bool).reshape(shape)
    row, column = np.nonzero(mask)
    high = np.unpackbits(content["level_high"], count=len(row)).astype(np.float64)
    squares = np.square(content["level_low"] + 256 * high)
    # The value of one squared level in each row is such that rows keep their sums.
    totals = np.bincount(row, squares, len(sums))
    unit = np.divide(sums, totals, out=np.zeros_like(sums), where=totals > 0)
    data = (squares * unit[row]).astype(np.float32)
    share = np.zeros(len(data), np.float32)
    share[content["direct_at"]] = content["direct_share"] / np.float32(255)
    indptr = np.concatenate([[0], np.cumsum(mask.sum(axis=1))])
    return Truth(
        csr_array((data, column.astype(np.int32), indptr.astype(np.int32)), shape=shape),
        data * share,
        tuple(int(v) for v in content["camera_shape"]),
        (rows, cols),
        json.loads(str(content["metadata"])),
    )


# The package holds the truths of these scenes, at this camera and projector size.
BUNDLED = ("l_objects", "gripper", "metal", "corner")
BUNDLED_SIZE = (64, 64)


def truth(
    name: str | Path | Truth,
    size: tuple[int, int] = BUNDLED_SIZE,
    *,
    camera: int = 1,
    samples: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Truth:
    """The known light transport matrix of a scene, a truth file or a simulated capture.

    Parameters
    ----------
    name : str, Path or Truth
        A scene that `scenes` lists: bundled, cached, or rendered now and then cached; or
        "procedural", which needs no renderer. Or a truth file, T.npz; or a simulated capture. A
        truth is returned unchanged.
    size : (rows, cols)
        Camera and projector size of a scene; each of several projectors has it. Bundled scenes have
        64 x 64.
    camera : int
        Number of the camera, from 1 on, in scenes that have several.
    samples : int, optional
        Paths per camera pixel; None takes the bundled file, or 16,384 where there is none.
    seed : int
        Seed of the paths.
    progress : callable, optional
        Called with (done, total) paths while the scene is rendered.

    Returns
    -------
    Truth
        The matrix, its direct part, and how it was made.

    Raises
    ------
    InputError
        On an unknown scene, an impossible size, or a file that is no truth.
    MissingExtraError
        If the scene must be rendered and Mitsuba is not installed.

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
        return Truth.load(as_path(name))
    if as_path(name).is_dir() and not (isinstance(name, str) and name in names()):
        if (Path(name) / TRUTH).is_file():
            return Truth.load(Path(name) / TRUTH)
        hint = "give a T.npz file, a capture made by `lightmatrix simulate`, or a scene"
        raise InputError(f"{name} holds no {TRUTH}", hint=hint)
    if as_path(name).is_file():
        raise InputError(f"{name}: is no truth", hint="give a T.npz file, a capture, or a scene")
    name = str(name)
    if name == PROCEDURAL:
        return ProceduralScene(size, size, seed).truth()
    built = seen_by(scene(name), camera)
    if name in BUNDLED and size == BUNDLED_SIZE and samples is None and seed == 0:
        with as_file(files("lightmatrix.simulation") / "data" / f"{name}.npz") as path:
            return _with_geometry(read_bundled(path), built)
    samples = samples or USUAL_SAMPLES
    rows, cols = size
    of_camera = f"-camera{camera}" if camera > 1 else ""
    key = f"{name}-v{built.version}{of_camera}-{rows}x{cols}-{samples}spp-seed{seed}.npz"
    path = cache_folder() / key
    if path.exists():
        try:
            return _with_geometry(Truth.load(path), built)
        except InputError:
            pass  # The file is damaged, so the scene is rendered again.
    rendered = render(name, size, camera=camera, samples=samples, seed=seed, progress=progress)
    try:
        rendered.save(path, overwrite=True)
    except OutputError as error:
        warn(f"the rendered matrix could not be cached: {error.message}")
    return rendered


def devices_of(name: str | Path) -> tuple[int, int]:
    """The numbers of projectors and of cameras of what `truth` takes: 1, but in some scenes."""
    built = scene(str(name)) if str(name) in names() else None
    return (1, 1) if built is None else (len(built.projectors), len(built.cameras))


def _with_geometry(known: Truth, built: Scene) -> Truth:
    """A truth of a whole scene whose file does not hold the geometry."""
    if built.more_projectors:
        return known
    return replace(known, geometry=view_geometry(built, known.camera_shape, known.projector_shape))


class SceneSummary(NamedTuple):
    """A scene of the simulator; whether it is bundled at 64 x 64; how many devices it has."""

    name: str
    description: str
    bundled: bool
    projectors: int = 1
    cameras: int = 1


def scenes() -> tuple[SceneSummary, ...]:
    """The scenes of the simulator.

    Returns
    -------
    tuple of SceneSummary
        Name, description, whether the scene is bundled at 64 x 64, and the numbers of projectors
        and cameras. Other scenes are rendered on first use and cached, which needs the extra
        `render`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> [scene.name for scene in lm.scenes() if scene.bundled]
    ['l_objects', 'gripper', 'metal', 'corner']
    """
    return tuple(
        SceneSummary(name, scene(name).description, name in BUNDLED, *devices_of(name))
        for name in names()
    )


def cache_folder() -> Path:
    """The folder of rendered truths, in the user's cache directory; made on first use."""
    return Path(platformdirs.user_cache_dir("lightmatrix", appauthor=False)) / "truth"
