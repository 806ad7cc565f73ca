"""The whole advice: exposures, patterns and frames, the error to expect, and what to type."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.exposure_sequence import exposure_sequence
from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.capture.white_frame import read_white_frame
from lightmatrix.errors import InputError
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.mix import FEWEST_MIXED, Mix, MixedPatterns, default_mix
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.planning.advice import (
    DENSITY,
    GLINTS,
    WhiteFrame,
    advise_density,
    advise_exposures,
    check_camera,
    clipped_share,
    single_clipped_share,
)
from lightmatrix.planning.table import ExpectedErrors, counts, expectations, frames_for
from lightmatrix.ranges import check_number
from lightmatrix.reprs import html_table, text_table
from lightmatrix.simulation import library
from lightmatrix.simulation.scenes import names
from lightmatrix.simulation.truth import Truth

USUAL_SIZE = (128, 128)
# Estimating from a folder whose capture.json says what two plain folders cannot.
ESTIMATE_FOLDER = "lightmatrix estimate capture/ -o scene.zarr"


@dataclass(frozen=True)
class AdvisedExposure:
    """One of the advised exposures.

    Parameters
    ----------
    exposure : float
        In the unit of the white frame's exposure.
    share : float
        Of the frames.
    frames : int
        As a number.
    clipped_share : float
        Share of its samples that will clip.
    """

    exposure: float
    share: float
    frames: int
    clipped_share: float


@dataclass(frozen=True, eq=False)
class Advice:
    """What to photograph; made by `plan`.

    Parameters
    ----------
    source : str
        The white frame, scene or truth that it was told from.
    simulated : bool
        Whether that is a scene or a truth, to be simulated, instead of a photograph.
    projector : (rows, cols)
    frames : int
        Number of frames K.
    patterns : {"mix", "bernoulli"}
        Kind of patterns.
    density : float
        Share of lit pixels.
    mix : sequence of ((rows, cols), share)
        Grids of cells lit as a whole, and their shares of the patterns.
    exposures : tuple of AdvisedExposure
        From the longest to the shortest.
    exposure_of_frames : (K,) float64
        Which frame gets which.
    white_clipped_share : float
        Share of the white frame's lit pixels that clipped.
    rows_that_clip_singly : float
        Share of the lit camera pixels that will clip under a single projector pixel even so.
    expected : tuple of ExpectedErrors
        Errors measured with this and with other numbers of frames.
    commands : tuple of str
        What to type.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> advice = lm.plan("metal", size=(64, 64), error=0.02)
    >>> advice.frames, advice.exposure, advice.make_patterns().count
    (64, '0.587:0.75,0.146:0.25', 64)
    """

    source: str
    simulated: bool
    projector: tuple[int, int]
    frames: int
    patterns: str
    density: float
    mix: Mix
    exposures: tuple[AdvisedExposure, ...]
    exposure_of_frames: NDArray[np.float64]
    white_clipped_share: float
    rows_that_clip_singly: float
    expected: tuple[ExpectedErrors, ...]
    commands: tuple[str, ...]

    def make_patterns(self, seed: int = 0) -> PatternSet:
        """The advised patterns, ready to be projected or simulated."""
        return make_patterns(
            self.patterns, self.projector, self.frames, density=self.density, seed=seed
        )

    @property
    def white_is_clipped(self) -> bool:
        """Whether more of the white frame clips than single glints, so that it tells too little."""
        return self.white_clipped_share > GLINTS

    @property
    def exposure(self) -> float | str:
        """The advised exposures as `simulate` takes them: a number, or numbers and shares."""
        if len(self.exposures) == 1:
            return self.exposures[0].exposure
        return ",".join(f"{e.exposure:g}:{e.share:.6g}" for e in self.exposures)

    def as_dict(self) -> dict[str, Any]:
        """All of it, JSON-ready: what `lightmatrix plan --json` prints."""
        return {
            "source": self.source,
            "projector": list(self.projector),
            "frames": self.frames,
            "patterns": self.patterns,
            "density": self.density,
            "mix": [{"grid": list(grid), "share": share} for grid, share in self.mix],
            "exposures": [asdict(exposure) for exposure in self.exposures],
            "exposure_of_frames": self.exposure_of_frames.tolist(),
            "white_clipped_share": self.white_clipped_share,
            "rows_that_clip_singly": self.rows_that_clip_singly,
            "expected": [asdict(errors) for errors in self.expected],
            "commands": list(self.commands),
        }

    def __repr__(self) -> str:
        return text_table("Advice", self._told)

    def _repr_html_(self) -> str:
        return html_table("Advice", self._told)

    @property
    def _told(self) -> dict[str, Any]:
        kind = "fine and coarse mixed" if self.patterns == "mix" else "all fine"
        told: dict[str, Any] = {
            "projector": " x ".join(map(str, self.projector)),
            "patterns": f"{self.frames}, random, {kind}, {100 * self.density:g} % lit",
        }
        for e in self.exposures:
            told[f"exposure {e.exposure:g}"] = (
                f"{e.frames} frames, {100 * e.clipped_share:.1f} % of their samples will clip"
            )
        for errors in self.expected:
            if errors.frames == self.frames:
                low, high = errors.relative_error
                told[f"error to expect, {errors.estimator}"] = f"{low:.3f} to {high:.3f}"
        return told


def plan(
    white: str | Path | Truth | WhiteFrame,
    *,
    size: tuple[int, int] | None = None,
    frames: int | None = None,
    error: float = 0.03,
    noise: float = USUAL_NOISE,
    exposure: float | None = None,
    shortest: float | None = None,
    black: str | Path | float | None = None,
    clip: float | None = None,
    response: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Advice:
    """Advise exposures, patterns and frames from a white frame or a scene.

    Parameters
    ----------
    white : str, Path, Truth or WhiteFrame
        Photograph of a white pattern; or a scene, a truth file (T.npz) or a truth, to simulate.
    size : (rows, cols), optional
        Projector pixels. None: 128 x 128; of a truth, its own.
    frames : int, optional
        Number of frames, at least 2. None: as many as `error` asks for.
    error : float
        Relative error of T that is good enough, in (0, 1).
    noise : float
        Standard deviation of a sample's noise, as a share of the clip level.
    exposure : float, optional
        Exposure of the white photograph in any unit, such as ms; the answer's too. None: 1.
    shortest : float, optional
        The camera's shortest exposure, in the same unit.
    black : str, Path or float, optional
        Photograph under a black pattern, or the black level in raw levels.
    clip : float, optional
        Raw level at which samples clip. None: the end of the range.
    response : str, optional
        See `Response.parse`. None: linear.
    progress : callable, optional
        Called with (done, total) paths where a scene has to be rendered.

    Returns
    -------
    Advice

    Raises
    ------
    InputError
        On numbers out of range, on photographs that cannot be read or tell nothing, and on what
        is for photographs given with a scene.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> advice = lm.plan("metal", size=(64, 64), frames=32)
    >>> advice
    Advice
      projector                  64 x 64
      patterns                   32, random, all fine, 50 % lit
      exposure 0.587             24 frames, 4.0 % of their samples will clip
      exposure 0.146             8 frames, 0.1 % of their samples will clip
      error to expect, plain     0.207 to 0.504
      error to expect, coherent  0.011 to 0.024
    >>> capture = lm.simulate("metal", advice.make_patterns(), exposure=advice.exposure)
    """
    if not 0 < error < 1:
        raise InputError(f"an error of {error}", hint="use a relative error, such as 0.05")
    if frames is not None and not 2 <= frames <= 1_000_000:
        raise InputError(f"{frames} frames", hint="use 2 to 1000000")
    check_camera(noise, shortest)
    simulated = (
        isinstance(white, Truth) or str(white).lower().endswith(".npz") or str(white) in names()
    )
    if isinstance(white, WhiteFrame):
        frame, projector = white, size or USUAL_SIZE
    elif simulated:
        given = {"exposure": exposure, "black": black, "clip": clip, "response": response}
        odd = [name for name, value in given.items() if value is not None]
        if odd:
            raise InputError(
                f"{', '.join(odd)} with a scene", hint="they are for photographs; leave them out"
            )
        frame, projector = _known(white, size, progress)
    else:
        unit = 1.0 if exposure is None else exposure
        hint = "use a number above 0, such as 20"
        check_number("an exposure", unit, most=1e9, above=True, hint=hint)
        frame, projector = _photograph(white, black, clip, response, unit), size or USUAL_SIZE
    source = str(white) if isinstance(white, str | Path) else type(white).__name__
    wanted = frames_for(error) if frames is None else frames
    exposures = advise_exposures(frame, noise, shortest, wanted)
    density = advise_density(frame, exposures)
    mix = default_mix(projector, wanted)
    per_frame = np.broadcast_to(
        exposure_sequence(exposures, MixedPatterns(projector, wanted, mix)), wanted
    )
    advised = tuple(
        AdvisedExposure(e, share, int((per_frame == e).sum()), clipped_share(frame, e, density))
        for e, share in exposures
    )
    advice = Advice(
        source,
        simulated,
        projector,
        wanted,
        "mix" if wanted >= FEWEST_MIXED else "bernoulli",
        density,
        mix,
        advised,
        per_frame,
        frame.clipped_share,
        single_clipped_share(frame, exposures),
        tuple(e for count in sorted({wanted, *counts()}) for e in expectations(count)),
        (),
    )
    return _with_commands(advice, black, clip, response)


def _known(
    source: str | Path | Truth | WhiteFrame,
    wanted: tuple[int, int] | None,
    progress: Callable[[int, int], None] | None,
) -> tuple[WhiteFrame, tuple[int, int]]:
    assert not isinstance(source, WhiteFrame)
    known = library.truth(source, wanted or USUAL_SIZE, progress=progress)
    if wanted not in (None, known.projector_shape):
        raise InputError(
            f"{source if isinstance(source, str | Path) else 'the truth'} has a projector of "
            f"{known.projector_shape[0]} x {known.projector_shape[1]}",
            hint="leave the size out",
        )
    levels = known.matrix.sum(axis=1, dtype=np.float64)
    return WhiteFrame(levels, np.zeros(len(levels), bool)), known.projector_shape


def _photograph(
    source: str | Path | Truth | WhiteFrame,
    black: str | Path | float | None,
    clip: float | None,
    response: str | None,
    exposure: float,
) -> WhiteFrame:
    assert isinstance(source, str | Path)
    frame = read_white_frame(source, ReadSettings(black=black, clip=clip, response=response))
    values = frame.values[:, 0].astype(np.float64) / exposure
    return WhiteFrame(values, frame.clipped[:, 0])


def _with_commands(
    advice: Advice, black: str | Path | float | None, clip: float | None, response: str | None
) -> Advice:
    size = "x".join(map(str, advice.projector))
    patterns = f"lightmatrix patterns {advice.patterns} -k {advice.frames} --size {size}"
    if advice.density != DENSITY:
        patterns += f" --density {advice.density:g}"
    lines = [f"{patterns} -o patterns/"]
    if advice.simulated:
        exposure = advice.exposure
        shown = exposure if isinstance(exposure, str) else f"{exposure:g}"
        scene = shlex.quote(advice.source)
        lines.append(
            f"lightmatrix simulate {scene} --patterns patterns/ --exposure {shown} -o capture/"
        )
        lines.append(ESTIMATE_FOLDER)
    else:
        lines.append(_estimate_photographs(advice, black, clip, response))
    return replace(advice, commands=tuple(lines))


def _estimate_photographs(
    advice: Advice, black: str | Path | float | None, clip: float | None, response: str | None
) -> str:
    """From two folders; from a capture folder where only capture.json can say all."""
    if len(advice.exposures) > 1 or isinstance(black, int | float):
        return ESTIMATE_FOLDER
    line = "lightmatrix estimate --patterns patterns/ --images photos/"
    for option, value in (("--black", black), ("--clip", clip), ("--response", response)):
        if value is not None:
            given = f"{value:g}" if isinstance(value, float) else shlex.quote(str(value))
            line += f" {option} {given}"
    return f"{line} -o scene.zarr"
