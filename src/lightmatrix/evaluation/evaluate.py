"""`lm.evaluate`: an estimate against the truth, each given as a matrix or by its place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from lightmatrix import store
from lightmatrix.errors import InputError
from lightmatrix.evaluation.estimate_errors import (
    ColourErrors,
    Errors,
    errors_by_rows,
    errors_in_colour,
)
from lightmatrix.files.colours import COLOURS, colour_paths
from lightmatrix.simulation import library
from lightmatrix.simulation.colour import is_of_all_primaries, of_primary
from lightmatrix.simulation.scenes import scene as find_scene
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.matrix import ColourTransport, LightTransport


def evaluate(
    estimate: LightTransport | str | Path,
    truth: LightTransport | Truth | str | Path,
    exposure: float = 1.0,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Errors:
    """Compare an estimate with the truth.

    Parameters
    ----------
    estimate : LightTransport, str or Path
        The estimate, or where `open` finds it.
    truth : LightTransport, Truth, str or Path
        The known T; a truth file, T.npz; a simulated capture; or a scene, rendered if need be. If
        the estimate is from cropped photographs, only its rows are compared.
    exposure : float
        Exposure of the capture, which decides which rows clip under one projector pixel.
    progress : callable, optional
        Called with (done, total) paths while the scene is rendered.

    Returns
    -------
    Errors
        Relative error, RMSE and relighting error, over all rows and over some kinds of rows.

    Raises
    ------
    InputError
        On matrices of different rigs, unknown scenes, or an exposure out of range.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> estimate = lm.estimate(capture, coherent=False, iterations=20)
    >>> errors = lm.evaluate(estimate, capture.truth, exposure=0.5)
    >>> 0.01 < errors.relative_error < 0.5
    True
    """
    return errors_by_rows(*_matrices(estimate, truth, progress), exposure)


def evaluate_colour(
    estimates: Sequence[LightTransport | str | Path] | ColourTransport | str | Path,
    truths: Sequence[LightTransport | Truth | str | Path] | ColourTransport | Truth | str | Path,
    exposure: float = 1.0,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> ColourErrors:
    """Compare the three matrices of a colour projector with the truth.

    Parameters
    ----------
    estimates, truths : sequence of three, ColourTransport, str or Path
        The matrices of red, green and blue, each as `evaluate` takes it; or a folder of three
        stores. Truths may also be the simulated capture of patterns in colour, or its truth.
    exposure : float
        Exposure of the captures, which decides which rows clip under one projector pixel.
    progress : callable, optional
        Called with (done, total) paths while a scene is rendered.

    Returns
    -------
    ColourErrors
        The errors of each matrix, and of the three together.

    Raises
    ------
    InputError
        As `evaluate`, and on a number of matrices other than three.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((16, 16), 8)
    >>> scene = lm.ProceduralScene((16, 16), (16, 16)).truth()
    >>> captures = [lm.simulate(scene, patterns, primary=name) for name in ("red", "green", "blue")]
    >>> truths = [capture.truth for capture in captures]
    >>> estimates = [truth.transport() for truth in truths]
    >>> lm.evaluate_colour(estimates, truths).relative_error
    0.0
    """
    if isinstance(estimates, str | Path):
        estimates = list(colour_paths(estimates))
    if isinstance(truths, Truth | str | Path):
        truths = _known_in_colour(truths)
    for matrices, word in ((estimates, "estimates"), (truths, "truths")):
        if len(matrices) != 3:
            raise InputError(f"{len(matrices)} {word}", hint="give those of red, green and blue")
    pairs = [_matrices(*pair, progress) for pair in zip(estimates, truths, strict=True)]
    return errors_in_colour([one for one, _ in pairs], [known for _, known in pairs], exposure)


def _known_in_colour(truth: Truth | str | Path) -> Sequence[LightTransport | str | Path]:
    """The truths of the three primaries: of one capture in colour, or of a folder for each."""
    if isinstance(truth, str | Path):
        folders = [Path(truth) / colour for colour in COLOURS]
        if all(folder.is_dir() for folder in folders):
            return folders
    known = library.truth(truth).transport()
    if known.projector_shape[1] % len(COLOURS) or not is_of_all_primaries(known):
        raise InputError(
            "a truth that is not of a colour projector",
            hint="give a capture that `lightmatrix simulate` made of patterns in colour, or a "
            "folder with the captures red, green and blue",
        )
    return [of_primary(known, colour) for colour in COLOURS]


def _matrices(
    estimate: LightTransport | str | Path,
    truth: LightTransport | Truth | str | Path,
    progress: Callable[[int, int], None] | None,
) -> tuple[LightTransport, LightTransport]:
    """The matrix of an estimate, and the truth of its rows."""
    matrix = estimate if isinstance(estimate, LightTransport) else store.open(estimate)
    known = truth if isinstance(truth, LightTransport) else _known(matrix, truth, progress)
    known = known.cropped_like(matrix)
    if matrix.shape != known.shape:
        names = [
            str(argument) if isinstance(argument, str | Path) else word
            for argument, word in ((estimate, "the estimate"), (truth, "the truth"))
        ]
        raise InputError(
            f"{names[0]} is {matrix.shape[0]} x {matrix.shape[1]}, "
            f"{names[1]} is {known.shape[0]} x {known.shape[1]}",
            hint="compare matrices of one rig with the same binning",
        )
    return matrix, known


def _known(
    estimate: LightTransport,
    truth: Truth | str | Path,
    progress: Callable[[int, int], None] | None,
) -> LightTransport:
    is_file = isinstance(truth, str) and (truth.lower().endswith(".npz") or Path(truth).is_dir())
    if isinstance(truth, str) and not is_file:
        _check_scene(estimate, truth)
    return library.truth(truth, estimate.projector_shape, progress=progress).transport()


def _check_scene(estimate: LightTransport, name: str) -> None:
    """Raise InputError if there is no scene of that name at the size of the estimate."""
    find_scene(name)
    region, projector = estimate.region, estimate.projector_shape
    camera = estimate.camera_shape if region is None else region.whole
    if camera != projector:
        raise InputError(
            f"the estimate has a camera of {' x '.join(map(str, camera))} and a projector of "
            f"{' x '.join(map(str, projector))}, but {name} is rendered with both of one size",
            hint="give the T.npz of the same rig",
        )
