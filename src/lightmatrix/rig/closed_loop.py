"""`lm.refine_compensation`: compensation on a rig, corrected by what the camera really sees."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.camera_curve import Response
from lightmatrix.errors import InputError, warn
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.reprs import ShortRepr
from lightmatrix.rig.devices.base import set_exposure
from lightmatrix.rig.devices.several import pattern_sizes, stacked
from lightmatrix.rig.photograph import (
    AveragedFrame,
    Photographer,
    find_white_and_black,
    take_average,
    take_white_and_black,
)
from lightmatrix.rig.rig import ProjectedPatterns, Rig, UnfitRigError
from lightmatrix.rig.rig_measurements import RigMeasurements, measure_rig
from lightmatrix.uses.compensation import (
    Compensation,
    Compensator,
    check_brightness,
    compensator,
    write_shown,
)
from lightmatrix.uses.loading import Transport
from lightmatrix.uses.wanted import WantedPicture, wanted_samples

USUAL_STEPS = 3
# Frames that are averaged for each photograph, and for white and black.
_FRAMES = 4


@dataclass(frozen=True, eq=False, repr=False)
class RefinedCompensation(ShortRepr):
    """A compensation on a rig, step by step; made by `refine_compensation`.

    Parameters
    ----------
    compensation : Compensation
        That of the best step.
    photograph : camera_shape float32
        What the camera saw in that step, without the room's light, in the units of T.
    photographed_psnr : (steps + 1,) float64
        The error of each photograph in dB, at first by T alone, then corrected. It counts samples
        that can be reached, as the first prediction says.
    """

    compensation: Compensation
    photograph: NDArray[np.float32]
    photographed_psnr: NDArray[np.float64]

    @property
    def pattern(self) -> NDArray[np.float32]:
        """The pattern of the best step, (rows, cols) in [0, 1]."""
        return self.compensation.pattern

    def as_dict(self) -> dict[str, Any]:
        """What `Compensation.as_dict` says, and the PSNR of each photograph; JSON-ready."""
        steps = [float(value) for value in self.photographed_psnr]
        return {**self.compensation.as_dict(), "photographed_psnr": steps}


def refine_compensation(
    rig: Rig,
    transport: Transport,
    wanted: WantedPicture,
    *,
    steps: int = USUAL_STEPS,
    mask: WantedPicture | None = None,
    projector_mask: WantedPicture | None = None,
    brightness: float | None = None,
    gamma: float | None = None,
    fit: str | None = None,
    response: str | None = None,
    keep: str | Path | None = None,
    settle: float | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    measuring: Callable[[str, int, int], None] | None = None,
    live: Callable[[float], bool] | None = None,
) -> RefinedCompensation:
    """Project a compensation, photograph it, and correct what is left, step by step.

    Each step adds what the photograph misses to what the solver is asked for, so that errors of T
    and of the projector's response fade. What counts is the light above the black frame: the room's
    light is subtracted.

    Parameters
    ----------
    rig : Rig
        See `open_rig`.
    transport : LightTransport, StoredTransport, str or Path
        T of this rig, or where `open` finds it. Its unit is fitted to a white photograph.
    wanted : (rows, cols) or (rows, cols, channels) array, str or Path
        The picture, as in `compensate`.
    steps : int
        Corrections, 0 to 100.
    mask, projector_mask, brightness, gamma, fit
        As in `compensate`.
    response : str, optional
        The camera's response; see `Response.parse`. None: that of T's capture.
    keep : str or Path, optional
        File of the rig's measurements; see `measure_rig`.
    settle : float, optional
        Seconds to wait after showing a picture; measured by default.
    output : str or Path, optional
        Image file to write the best pattern to, as `compensate` does.
    overwrite : bool
        Whether an existing image may be replaced.
    measuring : callable, optional
        Called with (part, done, total) while the rig is measured.
    live : callable, optional
        Called with the PSNR of each photograph; while it returns True, corrections go on, however
        many, and hold the scene right while its light changes. The last pattern is returned then.

    Returns
    -------
    RefinedCompensation

    Raises
    ------
    InputError
        As `compensate`, and if T is not of this rig's size.
    DeviceError
        If a device is lost or the camera does not see the projector.
    OutputError
        If the pattern cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:l_objects,real=0") as rig:
    ...     wanted = np.tile(np.linspace(0.2, 1, 64), (64, 1))
    ...     found = lm.refine_compensation(rig, rig.truth.transport(), wanted, steps=2, keep=None)
    >>> bool(found.photographed_psnr[-1] > found.photographed_psnr[0] - 0.5)
    True
    """
    if not hasattr(steps, "__index__") or not 0 <= steps <= 100:
        raise InputError(f"{steps} corrections", hint="use 0 to 100, such as 3")
    check_brightness(brightness)
    check_output(output, IMAGE, overwrite=overwrite)
    shared = compensator(transport, mask=mask, projector_mask=projector_mask)
    count, several = len(shared.light.matrices), len(pattern_sizes(rig.projector)) or 1
    if count != several:
        hint = "give the matrix of each projector of the rig"
        raise InputError(f"{count} matrices, for a rig of {several} projectors", hint=hint)
    captured = shared.light.matrices[0].provenance.get("capture_description")
    captured = captured if isinstance(captured, Mapping) else {}
    curve = response or captured.get("response") or "linear"
    cell, (down, across) = captured.get("cell", 1), captured.get("bin_projector", (1, 1))
    if down != across:
        hint = "estimate T without bin_projector"
        raise InputError(f"T of blocks of {down} x {across} projector pixels", hint=hint)
    samples = wanted_samples(wanted, shared.light.camera_shape, gamma=gamma, fit=fit)
    if brightness is None:
        brightness = shared.automatic_brightness(samples)
    known = measure_rig(
        rig, ("flicker", "response"), keep=keep, settle=settle, response=curve, progress=measuring
    )
    loop = _ClosedLoop(rig, known, shared, curve, cell * down)
    target = np.float32(brightness) * samples * shared.white_point
    asked, found = target, shared.reaching(target, brightness)
    # Samples that no pattern reaches would pull their neighbours further with every step.
    counted = found.reachable.ravel() if found.reachable.any() else shared.lit
    best: tuple[Compensation, NDArray[np.float32]] | None = None
    errors: list[float] = []
    for step in range(steps + 1) if live is None else itertools.count():
        if step:
            start = np.concatenate([pattern.ravel() for pattern in found.patterns])
            found = shared.reaching(target, brightness, start=start, asked=asked)
        seen = loop.photograph(found.patterns)
        missed = np.where(counted, target - seen, 0)
        mean_square = float(np.mean((missed[counted] / found.scale) ** 2))
        errors.append(-10 * float(np.log10(max(mean_square, 1e-12))))
        if best is None or live is not None or errors[-1] == max(errors):
            best = found, seen
        # What no pattern reaches must not pile up, or it would take as long to fade again.
        asked = np.clip(asked + missed, target - found.scale, target + found.scale)
        if live is not None and not live(errors[-1]):
            break
    assert best is not None
    found = replace(best[0], encoding=(loop.known.response,) * len(found.patterns))
    if output is not None:
        write_shown(output, found, overwrite=overwrite)
    photograph = best[1].reshape(shared.light.camera_shape)
    return RefinedCompensation(found, photograph, np.array(errors))


class _ClosedLoop:
    """A rig that is ready to photograph patterns in the units of T."""

    def __init__(
        self, rig: Rig, known: RigMeasurements, shared: Compensator, curve: str, cell: int
    ) -> None:
        """Choose an exposure, and compare white with what T says of it."""
        self.known = known
        assert known.settle is not None
        assert known.flicker is not None
        self.photographer = photographer = Photographer(rig, known.settle.seconds)
        whites = rig.persistently(lambda: find_white_and_black(photographer))
        exposure, period = whites.exposure, known.flicker.period
        if period:
            exposure = max(1, round(exposure / period)) * period
        exposure = set_exposure(rig.camera, exposure)
        whites = rig.persistently(lambda: take_white_and_black(photographer, exposure, _FRAMES))
        # Light of a photograph, as a share of the clip level, for each unit of T.
        self.curve, self.whites, self.unit = Response.parse(curve), whites, 1.0
        self.cell = cell
        light = self.light(whites.white)
        if light.size != shared.light.white.size:
            raise InputError(
                f"a matrix of a camera of shape {shared.light.camera_shape}, for a camera of shape "
                f"{whites.white.mean.shape}",
                hint="give the matrix that this rig measured, without crop or binning",
            )
        # Clipped samples are too dark.
        counted = shared.lit & (whites.white.mean.ravel() < 0.95 * whites.white.clip_level)
        expected = shared.light.white[counted]
        self.unit = float(light[counted] @ expected / max(float(expected @ expected), 1e-30))
        if not self.unit > 0:
            raise UnfitRigError(
                "the white photograph has nothing in common with the matrix",
                hint="give the matrix that this rig measured of this scene",
            )
        differs = np.linalg.norm(light[counted] / self.unit - expected) / np.linalg.norm(expected)
        # Of T of the scene it was 0.004 to 0.012 on virtual rigs, of other scenes 0.37 and more.
        if differs > 0.2:
            warn(
                f"the white photograph differs from what T says by {100 * differs:.0f} %: is it "
                "the matrix of this rig and this scene, and did nothing move since?"
            )

    def light(self, frame: AveragedFrame) -> NDArray[np.float32]:
        """Light of the projector in a frame, (M,), in the units of T."""
        black, top = self.whites.black.mean, frame.clip_level
        light = self.curve.linearise(frame.mean / top) - self.curve.linearise(black / top)
        return np.asarray(light.ravel() / self.unit, np.float32)

    def photograph(self, patterns: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """Show the pattern of each projector and photograph: the light, (M,), in the units of T."""
        rig = self.photographer.rig
        sizes = pattern_sizes(rig.projector, self.cell)
        pattern = stacked(patterns, sizes) if sizes else patterns[0]
        shown = ProjectedPatterns(
            ImagePatterns(pattern[None]), rig.projector.shape, self.cell, self.known.response
        )
        frame = rig.persistently(
            lambda: take_average(self.photographer, shown.image(0), self.whites.exposure, _FRAMES)
        )
        return self.light(frame)
