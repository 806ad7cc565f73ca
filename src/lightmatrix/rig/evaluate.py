"""Holding an estimate against the truth, wherever the two are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lightmatrix import store
from lightmatrix.errors import InputError
from lightmatrix.rig import library
from lightmatrix.rig.scenes import scene as find_scene
from lightmatrix.rig.truth import Truth
from lightmatrix.transport.evaluation import Errors, errors_by_rows
from lightmatrix.transport.matrix import LightTransport


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
        What is known; a truth file, T.npz; a simulated capture; or a scene, rendered if need be.
    exposure : float
        Exposure of the capture: tells which rows clip under one projector pixel.
    progress : callable, optional
        Called with (done, total) paths where the scene has to be rendered.

    Returns
    -------
    Errors
        Relative error, RMSE and relighting error, of all rows and of some kinds.

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
    found = estimate if isinstance(estimate, LightTransport) else store.open(estimate)
    known = truth if isinstance(truth, LightTransport) else _known(found, truth, progress)
    if found.shape != known.shape:
        names = [
            str(given) if isinstance(given, str | Path) else word
            for given, word in ((estimate, "the estimate"), (truth, "the truth"))
        ]
        raise InputError(
            f"{names[0]} is {found.shape[0]} x {found.shape[1]}, "
            f"{names[1]} is {known.shape[0]} x {known.shape[1]}",
            hint="compare matrices of one rig, binned alike",
        )
    return errors_by_rows(found, known, exposure)


def _known(
    estimate: LightTransport,
    truth: Truth | str | Path,
    progress: Callable[[int, int], None] | None,
) -> LightTransport:
    a_file = isinstance(truth, str) and (truth.lower().endswith(".npz") or Path(truth).is_dir())
    if isinstance(truth, str) and not a_file:
        _check_scene(estimate, truth)
    return library.truth(truth, estimate.projector_shape, progress=progress).transport()


def _check_scene(estimate: LightTransport, name: str) -> None:
    """Whether there is a scene of that name, at the size of the estimate."""
    find_scene(name)
    camera, projector = estimate.camera_shape, estimate.projector_shape
    if camera != projector:
        raise InputError(
            f"the estimate has a camera of {' x '.join(map(str, camera))} and a projector of "
            f"{' x '.join(map(str, projector))}, {name} is rendered with both of one size",
            hint="give the T.npz of the same rig",
        )
