"""`lm.plan`: advised exposures, patterns and frames, the expected error, and the commands.

The errors to expect were measured on rendered scenes. The entry `made_by` of table.json is the
command that measures them.
"""

import json
import shlex
import shutil
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.exposures import exposure_sequence
from lightmatrix.capture.folder import read_white_frame
from lightmatrix.capture.settings import FORMAT, NAME, VERSION, ReadSettings
from lightmatrix.defaults import FEWEST_BLACK_AND_WHITE, FEWEST_MIXED, USUAL_NOISE, USUAL_SIZE
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import CAPTURE
from lightmatrix.files.writing import atomic_folder
from lightmatrix.patterns.folder import fill_pattern_folder
from lightmatrix.patterns.grey import fewest_frames
from lightmatrix.patterns.making import make_patterns
from lightmatrix.patterns.mix import Mix, MixedPatterns, default_mix
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.planning import exposure_advice as advising
from lightmatrix.progress import Progress
from lightmatrix.ranges import as_float, check_number, check_sides, check_whole
from lightmatrix.reprs import text_table
from lightmatrix.simulation import library
from lightmatrix.simulation.scenes import names
from lightmatrix.simulation.truth import Truth


@dataclass(frozen=True)
class ExpectedErrors:
    """Smallest and largest error of one estimator over the scenes, at one number of frames."""

    # "row by row" or "coherent".
    estimator: str
    frames: int
    # Errors of T over all rows, and of relit images.
    relative_error: tuple[float, float]
    relighting_error: tuple[float, float]
    scenes: tuple[str, ...]
    # Whether this number of frames was measured, and not interpolated.
    measured: bool

    @property
    def patterns(self) -> str:
        """The kind of patterns: "grey", "fine" or "mix"."""
        return kind_for(self.frames)


def expectations(frames: int) -> list[ExpectedErrors]:
    """The errors of each estimator at a number of frames, by a power law between measured ones.

    None below the fewest that were measured, where errors are far larger. Those below 12 frames are
    of 64 x 64 pixels, as larger projectors need more. Patterns are grey below
    16 frames and mixed from 64 on, and exposures are those of `advise_exposures`.
    """
    rows = [
        row
        for row in table()
        if row["exposures"] == "advised"
        and row["density"] == 0.5
        and row["patterns"] == kind_for(row["frames"])
    ]
    result = list[ExpectedErrors]()
    if frames < counts()[0]:
        return result
    for estimator in sorted({row["estimator"] for row in rows}, reverse=True):
        measured = [row for row in rows if row["estimator"] == estimator]
        scenes = tuple(sorted({row["scene"] for row in measured}))
        kinds = "relative_error", "relighting_error"
        of_t, relit = (_error_range(measured, scenes, frames, kind) for kind in kinds)
        known = any(row["frames"] == frames for row in measured)
        result.append(ExpectedErrors(estimator, frames, of_t, relit, scenes, known))
    return result


def kind_for(frames: int) -> str:
    """The patterns that suit a number of frames, as the table names them."""
    if frames < FEWEST_BLACK_AND_WHITE:
        return "grey"
    return "mix" if frames >= FEWEST_MIXED else "fine"


# How `make_patterns` calls the kinds of patterns in the table of errors.
_MADE = {"grey": "random", "fine": "bernoulli", "mix": "mix"}


def counts() -> list[int]:
    """The measured numbers of frames."""
    return sorted({int(row["frames"]) for row in table()})


@cache
def table() -> list[dict[str, Any]]:
    """All rows of the table."""
    text = (files("lightmatrix.planning") / "table.json").read_text()
    rows: list[dict[str, Any]] = json.loads(text)["rows"]
    return rows


def _error_range(
    rows: list[dict[str, Any]], scenes: tuple[str, ...], frames: int, key: str
) -> tuple[float, float]:
    values = []
    for scene in scenes:
        points = sorted((row["frames"], row[key]) for row in rows if row["scene"] == scene)
        count, error = np.log(points).T
        values.append(float(np.exp(np.interp(np.log(frames), count, error))))
    return min(values), max(values)


@dataclass(frozen=True)
class AdvisedExposure:
    """One of the advised exposures, in the unit of the white frame's exposure."""

    exposure: float
    # Share and number of the frames at this exposure.
    share: float
    frames: int
    # Share of the samples that will clip.
    clipped_share: float


@dataclass(frozen=True, eq=False)
class Advice:
    """What to photograph; made by `plan`.

    Parameters
    ----------
    source, simulated : str, bool
        The white frame, scene or truth, and whether it is one of the latter, to be simulated.
    projector : (rows, cols)
        Pixels of the projector.
    frames, patterns, density : int, {"random", "bernoulli", "mix"}, float
        Number K and kind of patterns, and their share of lit pixels.
    mix : sequence of ((rows, cols), share)
        Grids whose cells are lit as a whole, and their shares of the patterns.
    exposures, exposure_of_frames : tuple of AdvisedExposure, (K,) float64
        Exposures, from the longest to the shortest, and that of each frame.
    white_clipped_share, rows_that_clip_singly : float
        Share of the white frame's lit pixels that clipped, and of the lit camera pixels that will
        clip under a single projector pixel.
    expected : tuple of ExpectedErrors
        Errors to expect with this and with other numbers of frames, of the better estimator; none
        of fewer frames than were measured.
    commands : tuple of str
        Commands to run.
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
        """Whether more than single glints of the white frame clip."""
        return self.white_clipped_share > advising.RULES.glints

    @property
    def too_bright(self) -> bool:
        """Whether many single responses will clip, so that errors are larger than expected."""
        return self.rows_that_clip_singly > advising.RULES.clipped_singly

    @property
    def exposure(self) -> float | str:
        """The advised exposures as `simulate` takes them: a number, or numbers and shares."""
        if len(self.exposures) == 1:
            return self.exposures[0].exposure
        return ",".join(f"{e.exposure:g}:{e.share:.6g}" for e in self.exposures)

    def as_dict(self) -> dict[str, Any]:
        """The content of `lightmatrix plan --json`."""
        content = asdict(self) | {
            "mix": [{"grid": grid, "share": share} for grid, share in self.mix],
            "exposure_of_frames": self.exposure_of_frames.tolist(),
        }
        del content["simulated"]
        result: dict[str, Any] = json.loads(json.dumps(content))
        return result

    def __repr__(self) -> str:
        return text_table("Advice", self._summary)

    @property
    def _summary(self) -> dict[str, Any]:
        lit = f"{100 * self.density:g} % lit"
        kinds = {"random": "in grey levels", "bernoulli": f"all fine, {lit}"}
        kind = kinds.get(self.patterns, f"fine and coarse mixed, {lit}")
        summary: dict[str, Any] = {
            "projector": " x ".join(map(str, self.projector)),
            "patterns": f"{self.frames}, random, {kind}",
        }
        for e in self.exposures:
            summary[f"exposure {e.exposure:g}"] = (
                f"{e.frames} frames, {100 * e.clipped_share:.1f} % of their samples will clip"
            )
        for errors in self.expected:
            if errors.frames == self.frames:
                low, high = errors.relative_error
                summary["error to expect"] = f"{low:.3f} to {high:.3f}"
        return summary


def plan(
    white: str | Path | Truth | advising.WhiteFrame,
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
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Advice:
    """Advise exposures, patterns and frames from a white frame or a scene.

    Parameters
    ----------
    white : str, Path, Truth or WhiteFrame
        Photograph of a white pattern; or a scene, a truth file (T.npz) or a truth, to simulate.
    size : (rows, cols), optional
        Projector pixels. None: 128 x 128, or those of a truth.
    frames : int, optional
        Number of frames, at least 8 to 16, by the size. None: as many as `error` needs.
    error : float
        Wanted relative error of T, in (0, 1).
    noise : float
        Standard deviation of a sample's noise, as a share of the clip level.
    exposure : float, optional
        Exposure of the white photograph in any unit, such as ms, which the advice uses too.
        None: 1.
    shortest : float, optional
        The camera's shortest exposure, in the same unit.
    black : str, Path or float, optional
        Photograph under a black pattern, or the black level in raw levels.
    clip : float, optional
        Raw level at which samples clip. None: the end of the range.
    response : str, optional
        See `Response.parse`. None: linear.
    output : str or Path, optional
        A capture folder to write, with the patterns and a capture.json that holds the exposure of
        each frame; it lacks its photographs, images/. Only for photographs.
    overwrite : bool
        Whether `output` may replace a capture folder.
    progress : callable, optional
        Called with (done, total) paths while a scene is rendered.

    Returns
    -------
    Advice
        Exposures, patterns and frames, with the errors to expect and the commands to run.

    Raises
    ------
    InputError
        On numbers out of range, unreadable, dark or clipped photographs, and settings of
        photographs with a scene.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> advice = lm.plan("metal", size=(64, 64), frames=32)
    >>> advice
    Advice
      projector        64 x 64
      patterns         32, random, all fine, 50 % lit
      exposure 0.587   24 frames, 4.0 % of their samples will clip
      exposure 0.146   8 frames, 0.1 % of their samples will clip
      error to expect  0.011 to 0.024
    >>> capture = lm.simulate("metal", advice.make_patterns(), exposure=advice.exposure)
    """
    if not 0 < as_float(error) < 1:
        raise InputError(f"an error of {error}", hint="use a relative error, such as 0.05")
    if frames is not None:
        check_whole("frames", frames, least=2, most=1_000_000, hint="use 16, or more")
    advising.check_camera(noise, shortest)
    of_photograph = {"exposure": exposure, "black": black, "clip": clip, "response": response}
    of_photograph |= {"output": output}
    if size is not None:
        check_sides("a projector", size)
    projector, simulated = USUAL_SIZE if size is None else size, False
    if isinstance(white, advising.WhiteFrame):
        frame = white
    elif isinstance(white, Truth) or str(white).lower().endswith(".npz") or str(white) in names():
        present = [name for name, value in of_photograph.items() if value is not None]
        if present:
            hint = "these settings are for photographs; leave them out"
            raise InputError(f"{', '.join(present)} with a scene", hint=hint)
        simulated, known = True, library.truth(white, projector, progress=progress)
        projector = known.projector_shape
        if size not in (None, projector):
            raise InputError(
                f"{white if isinstance(white, str | Path) else 'the truth'} has a projector of "
                f"{projector[0]} x {projector[1]}",
                hint="leave the size out",
            )
        levels = known.matrix.sum(axis=1, dtype=np.float64)
        frame = advising.WhiteFrame(levels, np.zeros(len(levels), bool))
    else:
        unit = 1.0 if exposure is None else exposure
        hint = "use a number above 0, such as 20"
        check_number("an exposure", unit, most=1e9, above=True, hint=hint)
        settings = ReadSettings(black=black, clip=clip, response=response)
        photograph = read_white_frame(white, settings)
        values = photograph.values[:, 0].astype(np.float64) / unit
        frame = advising.WhiteFrame(values, photograph.clipped[:, 0])
    fewest = fewest_frames(projector[0] * projector[1])
    if frames is None:
        # The fewest measured frames that reach the error on the worst scene, or the most.
        worst = {n: min(e.relative_error[1] for e in expectations(n)) for n in counts()}
        frames = max(next((n for n in worst if worst[n] <= error), counts()[-1]), fewest)
    count = frames
    if count < fewest:
        raise InputError(
            f"{count} photographs do not tell {projector[0]} x {projector[1]} pixels apart",
            hint=f"take {fewest} or more, better {FEWEST_BLACK_AND_WHITE}",
        )
    exposures = advising.advise_exposures(frame, noise, shortest, count)
    kind = _MADE[kind_for(count)]
    density = advising.DENSITY if kind == "random" else advising.advise_density(frame, exposures)
    mix = default_mix(projector, count)
    sequence = exposure_sequence(exposures, MixedPatterns(projector, count, mix))
    per_frame = np.broadcast_to(sequence, count)
    advice = Advice(
        source=str(white) if isinstance(white, str | Path) else type(white).__name__,
        simulated=simulated,
        projector=projector,
        frames=count,
        patterns=kind,
        density=density,
        mix=mix,
        exposures=tuple(
            AdvisedExposure(
                e, share, int((per_frame == e).sum()), advising.clipped_share(frame, e, density)
            )
            for e, share in exposures
        ),
        exposure_of_frames=per_frame,
        white_clipped_share=frame.clipped_share,
        rows_that_clip_singly=advising.single_clipped_share(frame, exposures),
        expected=tuple(
            min(expectations(k), key=lambda each: each.relative_error[1])
            for k in sorted({count, *counts()})
            if expectations(k)
        ),
        commands=(),
    )
    if output is None:
        return replace(advice, commands=_commands(advice, black, clip, response))
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "projector_shape": list(projector),
        "exposure": per_frame.tolist() if len(exposures) > 1 else exposures[0][0],
    }
    level = black if isinstance(black, int | float) else None
    stated = {"clip": clip, "response": response, "black_level": level}
    content |= {name: value for name, value in stated.items() if value is not None}
    with atomic_folder(output, CAPTURE, overwrite=overwrite) as part:
        (part / "patterns").mkdir()
        fill_pattern_folder(part / "patterns", advice.make_patterns())
        if isinstance(black, str | Path):
            name = f"black{Path(black).suffix}"
            shutil.copyfile(black, part / name)
            content["black"] = {"file": name, "exposure": exposure or 1.0}
        (part / NAME).write_text(json.dumps(content, indent=2) + "\n")
    command = f"lightmatrix estimate {shlex.quote(str(output))} -o scene.zarr"
    return replace(advice, commands=(command,))


def _commands(
    advice: Advice, black: str | Path | float | None, clip: float | None, response: str | None
) -> tuple[str, ...]:
    """The commands that make the patterns, simulate if there is no rig, and estimate."""
    size = "x".join(map(str, advice.projector))
    patterns = f"lightmatrix patterns {advice.patterns} -k {advice.frames} --size {size}"
    if advice.density != advising.DENSITY:
        patterns += f" --density {advice.density:g}"
    patterns += " -o patterns/"
    whole = "lightmatrix estimate capture/ -o scene.zarr"
    if advice.simulated:
        exposure = advice.exposure if isinstance(advice.exposure, str) else f"{advice.exposure:g}"
        simulate = (
            f"lightmatrix simulate {shlex.quote(advice.source)} --patterns patterns/ "
            f"--exposure {exposure} -o capture/"
        )
        return patterns, simulate, whole
    # Only the capture.json of a capture folder can hold exposures and a black level.
    if len(advice.exposures) > 1 or isinstance(black, int | float):
        return patterns, whole
    line = "lightmatrix estimate --patterns patterns/ --images photos/"
    for option, value in (("black", black), ("clip", clip), ("response", response)):
        if value is not None:
            text = f"{value:g}" if isinstance(value, float) else shlex.quote(str(value))
            line += f" --{option} {text}"
    return patterns, f"{line} -o scene.zarr"
