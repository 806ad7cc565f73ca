"""`lm.cancel_global`: the pattern under which the camera sees direct light only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.writing import check_output
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.compensation import Compensation, compensator
from lightmatrix.uses.images import write_shown
from lightmatrix.uses.joint_light import joint_light
from lightmatrix.uses.loading import Transport
from lightmatrix.uses.separation import pattern_or_white, separate

# Iterations of the solver. Chosen by hand: twice as many as a compensation takes.
_ITERATIONS = 50


def cancel_global(
    transport: Transport,
    pattern: NDArray[Any] | str | Path | None = None,
    *,
    direct: LightTransport | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Compensation:
    """The pattern under which the camera sees what a pattern gives by direct light only.

    Seitz, Matsushita & Kutulakos ("A Theory of Inverse Light Transport", ICCV 2005) cancel
    interreflections in a photograph by the inverse of T. Here the projector does it: with the
    direct part D of T, the pattern q with T q = D p makes the camera see D p. It is found as
    `compensate` finds patterns, within [0, 1].

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it.
    pattern : (rows, cols) array, str or Path, optional
        The pattern p in [0, 1]. None: white.
    direct : LightTransport, optional
        The direct part D. None: that of `separate`.
    output : str or Path, optional
        Image file to write the pattern q to, as `compensate` does.
    overwrite : bool
        Whether an existing image may be replaced.

    Returns
    -------
    Compensation
        Its target is D p. `reach` says where more is left than 5 % of the light of white.

    Raises
    ------
    InputError
        On a pattern of another size, or a T without direct light.
    OutputError
        If the pattern cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.cancel_global(lm.truth("l_objects").transport())
    >>> bool(found.pattern.mean() < 1)
    True
    """
    if output is not None:
        check_output(output, IMAGE, overwrite=overwrite)
    light = joint_light(transport)
    light.check_single()
    matrix = light.matrices[0]
    shown = pattern_or_white(pattern, matrix.projector_shape)
    part = separate(matrix).direct if direct is None else direct
    if part.shape != matrix.shape:
        raise InputError(
            f"direct light of {part.shape[0]} x {part.shape[1]}, for a matrix of {matrix.shape[0]} "
            f"x {matrix.shape[1]}",
            hint="give the direct part of the same matrix",
        )
    target = part.relight(shown)
    if not target.any():
        raise InputError(
            "the pattern gives no direct light", hint="give a pattern that lights the scene"
        )
    # The target is made from T, with the same errors, so that no row is trusted less.
    shared = replace(compensator(matrix), weigh_errors=False)
    compensation = shared.reaching(target.ravel(), 1.0, start=shown.ravel(), iterations=_ITERATIONS)
    if output is not None:
        write_shown(output, compensation.patterns, overwrite=overwrite)
    return compensation
