"""How far to trust an estimate: `lm.verdicts` judges T and what it is used for.

T is judged by the errors that an estimate states of its own rows. Photographs held out of an
estimate do not show what is wrong with all photographs alike, nor what none of them shows. The
diagnostics of the rows reveal some of this (`lightmatrix.estimators.coherent.row_errors`); where
they do, no error of T is stated, and the reason stands in its place.

Whether a map of correspondences is right, whether T relights scenes, and whether it is T are
different questions: stripes settle the first where they say nothing of the others.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from lightmatrix.judgement.metrics import row_energies, unclipped_rows
from lightmatrix.ranges import check_type
from lightmatrix.reprs import html_table, percent
from lightmatrix.rig_model.model import RigModel
from lightmatrix.transport.matrix import LightTransport, prediction_error
from lightmatrix.transport.operator import HOW_TO_GIVE, TransportOperator

Level = Literal["good", "fair", "doubtful", "not tested"]

# An estimate is called good up to the first relative error of T, and fair up to the second. A
# correspondence is judged likewise by the share of the pixels that are uncertain. Both were chosen
# by hand; no measurement stands behind them.
GOOD, FAIR = 0.05, 0.2
# A report advises shorter exposures if rows that clip whenever their strongest pixel is lit hold
# more than this share of the squared light. Chosen by hand.
SINGLY_CLIPPED = 0.02
# Kinds of findings of `check` that spoil T where neither estimated errors nor unseen photographs
# show it; and those after which photographs held out, which are wrong alike, test nothing.
_SPOILING = (
    *("clip", "order", "unrelated", "motion", "patterns", "shift", "rows", "previous", "crosstalk"),
    *("camera-curve", "projector-curve", "sharpening", "camera-sharpening", "dynamic-contrast"),
    *("tone-mapping", "black"),
)
_WRONG_ALIKE = ("order", "unrelated", "motion")
_UNTESTED = "It was not tested on unseen photographs, as a report does."

_EACH_NEEDED = "T needs each photograph, so that none was held out."


@dataclass(frozen=True)
class _Doubtful:
    """When no error of T is stated.

    All values were chosen on the training half of `python -m benchmarks.honesty`, 180 captures of
    16 x 16 and 32 x 32 pixels.
    """

    # Light that does not follow the brightness of patterns, relative to the mean sample. Intact
    # captures have at most 0.03, those with a pedestal or a leak 0.09 to 0.45.
    constant: float = 0.05
    # Residuals that bend with the prediction, relative to the contrast of rows. Intact captures
    # have at least -0.003, those through a gamma curve -0.07 to -0.013.
    bent: float = -0.01
    # Share of the squared light in rows that are only bounded. Intact captures have at most 0.6,
    # those exposed four times too long 0.7 to 1. Below it, such rows err by about
    # `bounded_error`, relative to their length: by 0.04 to 0.17.
    bounded: float = 0.65
    bounded_error: float = 0.12
    # Such rows let T err by about this, too, times their share of the squared light: by 0.05 to
    # 0.18 at shares of 0.2 to 0.6, and by 0.19 to 0.35 at 0.64 to 0.8.
    singly_clipped_error: float = 0.4
    # A sample lies in a highlight if three of its eight neighbours clip in nearly as large a share
    # of the frames. On the bundled scene `metal`, the brightest pixel clips in 0.81 of 32 frames,
    # its neighbours in up to 0.72. Pixels around a lone glint clip in few.
    apart: float = 0.15


DOUBTFUL = _Doubtful()


@dataclass(frozen=True)
class Verdict:
    """How far to trust an estimate.

    Parameters
    ----------
    level : {"good", "fair", "doubtful", "not tested"}
        The verdict in a word.
    error : float, optional
        The relative error that the estimate states. None: it states none.
    reasons : tuple of str
        What else bears on the verdict, in short sentences with their numbers.
    measure : str
        What the error is.
    """

    level: Level
    error: float | None = None
    reasons: tuple[str, ...] = ()
    measure: str = "Estimated error of T"

    @property
    def sentence(self) -> str:
        """The error and the reasons in words."""
        stated = () if self.error is None else (f"{self.measure}: {percent(self.error)}.",)
        return " ".join([*stated, *self.reasons])

    def __str__(self) -> str:
        return f"{self.level.capitalize()}. {self.sentence}"

    def with_findings(
        self, kinds: Iterable[str], spoiling: Collection[str] = _SPOILING
    ) -> "Verdict":
        """The verdict, doubtful and without error if some `kinds` of findings are `spoiling`.

        These are the kinds that no error estimate shows. The verdict is fair at best where nothing
        tells whether the photographs are linear in light.
        """
        kinds = set(kinds)
        if found := sorted(kinds & set(spoiling)):
            doubt = f"The check found what no error estimate shows ({', '.join(found)})."
            level: Level = self.level if self.level == "not tested" else "doubtful"
            return replace(self, level=level, error=None, reasons=(*self.reasons, doubt))
        if "unlit" in kinds:
            unlit = "Nothing is known of the projector pixels that no pattern lit."
            return replace(self, reasons=(*self.reasons, unlit))
        if "linearity" in kinds and spoiling == _SPOILING and self.level == "good":
            untested = "Whether the photographs are linear in light could not be tested."
            return replace(self, level="fair", reasons=(*self.reasons, untested))
        return self


@dataclass(frozen=True)
class Verdicts:
    """An estimate judged by three questions.

    Parameters
    ----------
    correspondence : Verdict
        Whether the strongest projector pixel of each lit camera pixel is the right one.
    relighting : Verdict
        Whether T predicts photographs that were held out.
    transport : Verdict
        Whether it is T; the overall verdict.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.5)
    >>> judged = lm.verdicts(lm.estimate(capture, coherent=False, iterations=20))
    >>> judged.relighting.level, sorted(judged.as_dict())
    ('not tested', ['correspondence', 'relighting', 'transport'])
    """

    correspondence: Verdict
    relighting: Verdict
    transport: Verdict

    @classmethod
    def from_dict(cls, verdicts: Mapping[str, Mapping[str, Any]]) -> Self:
        """The verdicts of `as_dict`."""
        facts = {
            name: (each["verdict"], each["error"], tuple(each["reasons"]), each["measure"])
            for name, each in verdicts.items()
        }
        return cls(**{name: Verdict(*each) for name, each in facts.items()})

    def _repr_html_(self) -> str:
        rows = (line.partition(": ") for line in self.lines())
        return html_table("Verdicts", {question: answer for question, _, answer in rows})

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """The verdicts by their names, each with its parts and its sentence, JSON-ready."""
        return {
            name: {"verdict": each.level, "sentence": each.sentence, "error": each.error}
            | {"reasons": list(each.reasons), "measure": each.measure}
            for name, each in vars(self).items()
        }

    def lines(self) -> list[str]:
        """A line for each verdict, the overall one first."""
        return [
            f"T: {self.transport}",
            f"Relighting: {self.relighting}",
            f"Correspondence: {self.correspondence}",
        ]


def verdicts(transport: LightTransport) -> Verdicts:
    """Judge the correspondence, the relighting and the T of an estimate.

    T is judged by the errors that the estimate states of its own rows. It is doubtful if `check`
    found in the capture what these do not show; the provenance holds its findings.

    Parameters
    ----------
    transport : LightTransport
        An estimate.

    Returns
    -------
    Verdicts
        "not tested" where nothing bears on a question, as for a matrix without diagnostics.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.15)
    >>> lm.verdicts(lm.estimate(capture)).relighting.level
    'good'
    """
    check_type("a light transport matrix", transport, TransportOperator, hint=HOW_TO_GIVE)
    kinds = stored_findings(transport)
    return Verdicts(
        correspondence_verdict(transport, kinds),
        relighting_verdict(transport, kinds),
        verdict_by_rows(transport).with_findings(kinds),
    )


def verdict_by_rows(transport: LightTransport, why_untested: str = _UNTESTED) -> Verdict:
    """The verdict by the diagnostics of the rows alone, whatever was found in the capture.

    `why_untested` is a sentence to add where no row has an estimated error.
    """
    diagnostics = transport.diagnostics
    if not diagnostics:
        return Verdict("not tested", None, ("The matrix has no diagnostics.",))
    remarks, own = list[str](), OwnError(transport)
    # Without the blur of a camera, T is solved again by another iteration.
    if "converged" in diagnostics and "camera-blur" not in RigModel.of(transport).values:
        finished = float(np.mean(diagnostics["converged"]))
        remarks.append(
            f"{percent(finished)} of the rows converged."
            if finished >= 0.99
            else f"{percent(1 - finished)} of the rows reached the iteration limit."
        )
    often = float(np.mean(np.asarray(diagnostics.get("clipped_share", np.zeros(1))) > 0.5))
    if often > 0.1:
        remarks.append(f"{percent(often)} of the rows clipped in more than half of their samples.")
    if own.estimated is None:
        if transport.provenance.get("estimator") == "direct":
            why_untested = f"{_EACH_NEEDED} Hardly an entry is dark, which would show the noise."
        level: Level = "doubtful" if own.doubts else "not tested"
        return Verdict(level, None, (*own.doubts, *remarks, why_untested))
    error = own.stated
    if error is None:
        return Verdict("doubtful", None, ("The error of T is not known.", *own.doubts, *remarks))
    level = level_of(error)
    if level == "doubtful":
        remarks.append(
            "More patterns help most, then an exposure that uses the camera's range, or binned "
            "projector pixels. Neighbouring camera pixels must see neighbouring projector pixels."
        )
    return Verdict(level, error, (*own.warnings, *remarks))


def correspondence_verdict(transport: LightTransport, findings: Iterable[str] = ()) -> Verdict:
    """Judge the map of strongest projector pixels by the share of lit pixels that are certain."""
    certain = _diagnostic(transport, "certain")
    known = np.isfinite(certain)
    if known.any():
        # A camera sample is lit if a white pattern gives it more than 2 % of what it gives bright
        # samples, as in the report.
        white = transport.relight(np.ones(transport.projector_shape, np.float32)).ravel()
        known &= white > 0.02 * np.quantile(white, 0.99)
    if not known.any():
        unknown = "Whether the strongest projector pixels are certain is not known."
        return Verdict("not tested", None, (unknown,))
    share = float(certain[known].mean())
    reason = (
        f"{percent(share)} of the lit camera pixels are certain of the projector pixel that they "
        "see most."
    )
    judged = Verdict(level_of(1 - share), None, (reason,))
    return judged.with_findings(findings, _WRONG_ALIKE)


def relighting_verdict(transport: LightTransport, findings: Iterable[str] = ()) -> Verdict:
    """Judge the images that T predicts by the photographs held out of the last round.

    These do not show the light beyond the clip level, which linear images have.
    """
    error = prediction_error(transport)
    if error is None:
        needed = transport.provenance.get("estimator") == "direct"
        unknown = _EACH_NEEDED if needed else "No photograph could be held out and predicted."
        return Verdict("not tested", None, (unknown,))
    own = OwnError(transport)
    level = "doubtful" if own.light_doubts else level_of(np.hypot(error, own.beyond_clip))
    reasons = (*own.light_doubts, *own.warnings)
    judged = Verdict(level, error, reasons, "Prediction error on photographs held out")
    return judged.with_findings(findings, _WRONG_ALIKE)


def level_of(error: float | np.floating) -> Level:
    """The verdict on a relative error."""
    return "good" if error <= GOOD else "fair" if error <= FAIR else "doubtful"


def stored_findings(transport: LightTransport) -> tuple[str, ...]:
    """The kinds of the findings that the provenance holds; none if it holds anything else."""
    kept = transport.provenance.get("findings")
    if not isinstance(kept, (list, tuple)):
        return ()
    kinds = (each.get("kind") for each in kept if isinstance(each, Mapping))
    return tuple(kind for kind in kinds if isinstance(kind, str))


@dataclass(frozen=True, eq=False)
class OwnError:
    """What the diagnostics of an estimate say of its error, each computed once."""

    transport: LightTransport

    @cached_property
    def stated(self) -> float | None:
        """The relative error of T that the estimate states, also for light that is only bounded.

        None if no row has an estimated error, or if there are `doubts`.
        """
        if self.estimated is None or self.doubts:
            return None
        return float(np.hypot(self.estimated, self.beyond_clip))

    @cached_property
    def beyond_clip(self) -> float:
        """The relative error of T that follows from the light that no photograph shows."""
        bounded = DOUBTFUL.bounded_error * np.sqrt(self._bounded_share)
        return float(np.hypot(bounded, DOUBTFUL.singly_clipped_error * self.singly_clipped))

    @cached_property
    def singly_clipped(self) -> float:
        """Share of the squared light in rows that clip whenever their strongest pixel is lit.

        Where the estimate does not say so, they are those that clip under a single projector pixel
        at the shortest exposure of the provenance; 0 where that is unknown.
        """
        if _diagnostic(self.transport, "only_bounded").size:
            return self._bounded_share
        # The provenance of a store may hold anything. Nothing clips at an exposure of 0.
        try:
            exposure = float(np.min(self.transport.provenance["capture_description"]["exposure"]))
        except (TypeError, ValueError, KeyError):
            exposure = 0.0
        exposure = exposure if np.isfinite(exposure) else 0.0
        return self._share(~unclipped_rows(self.transport, exposure))

    @property
    def warnings(self) -> list[str]:
        """Sentences if light is only bounded from below, or is unknown since a change."""
        warnings, share = list[str](), self.unknown_share
        # Less than 0.2 % is not worth a sentence.
        if self.singly_clipped > SINGLY_CLIPPED / 10:
            warnings.append(
                f"But {percent(self.singly_clipped)} of the squared light is in rows that clip "
                "whenever their strongest projector pixel is lit: no photograph shows by how much."
            )
        if 0 < share <= 0.5:
            of = f"{percent(share)} of the light is in rows that changed"
            warnings.append(f"{of} and are not known yet; further photographs tell.")
        return warnings

    @cached_property
    def unknown_share(self) -> float:
        """Share of the light in rows that a `Tracker` does not know since they changed."""
        return _mean(_diagnostic(self.transport, "unknown"), self._light)

    @cached_property
    def _light(self) -> NDArray[np.float64]:
        light = np.asarray(self.transport.sparse.sum(axis=1), float).ravel()
        return np.asarray(light + self.transport.background.sum(axis=1, dtype=float))

    def _share(self, rows: NDArray[np.bool_]) -> float:
        """The share of the squared light in some rows."""
        total = float(self._energies.sum())
        return float(self._energies[rows].sum()) / total if rows.size and total else 0.0

    @cached_property
    def estimated(self) -> float | None:
        """||error of T|| / ||T|| in the Frobenius norm, by the errors that its rows estimate.

        Over the rows that have such an error; None if no row has.
        """
        errors = _diagnostic(self.transport, "estimated_error")
        known = np.flatnonzero(np.isfinite(errors))
        if not known.size:
            return None
        energy = self._energies[known]
        total = float(energy.sum())
        wrong = float((energy * errors[known] ** 2).sum())
        return float(np.sqrt(wrong / total)) if total else float(np.median(errors[known]))

    @cached_property
    def _energies(self) -> NDArray[np.float64]:
        return row_energies(self.transport)

    @cached_property
    def _bounded_share(self) -> float:
        return self._share(_diagnostic(self.transport, "only_bounded") > 0)

    @cached_property
    def doubts(self) -> list[str]:
        """Why no error of T can be stated, in sentences; none for most estimates."""
        transport, doubts = self.transport, list[str]()
        constant = _mean(_diagnostic(transport, "constant_light"), self._light)
        if constant > DOUBTFUL.constant:
            doubts.append(
                f"About {100 * constant:.0f} % of the light does not follow the patterns: an "
                "electronic pedestal, light of the room, or a projector whose black is not dark. "
                "Take a photograph under a black pattern, and state it as the black frame."
            )
        if _mean(_diagnostic(transport, "bend"), self._energies) < DOUBTFUL.bent:
            doubts.append(
                "Bright samples are darker than T predicts: the camera does not seem linear in "
                "light. State its response, or take raw photographs."
            )
        return doubts + self.light_doubts

    @cached_property
    def light_doubts(self) -> list[str]:
        """Those of the doubts that are about rows, or light beyond the clip level, that T lacks."""
        if self.unknown_share > 0.5:
            return [
                f"{percent(self.unknown_share)} of the light is in rows that the last photographs "
                "contradict: they are out of step with the patterns, or show others; or camera, "
                "projector or room light changed, which takes a new capture."
            ]
        glints = _glints(self.transport)
        if glints:
            pixels = "1 camera sample clips" if glints == 1 else f"{glints} camera samples clip"
            return [
                f"{pixels} in most photographs, and none shows how bright it is: a glint, or a "
                "hot pixel. Mask it, or add photographs of shorter exposure."
            ]
        if self._bounded_share > DOUBTFUL.bounded:
            return [
                "Most of the light comes from camera pixels that clip whenever the projector pixel "
                "that they see is lit. Add photographs of shorter exposure."
            ]
        return []


def _glints(transport: LightTransport) -> int:
    """Number of camera samples that may be far brighter than their bound.

    Where neighbours clip nearly as often, the sample lies in a highlight, and is about as bright.
    """
    glint = _diagnostic(transport, "glint") > 0
    if not glint.any():
        return 0
    rows, cols = transport.camera_shape[:2]
    image = _diagnostic(transport, "clipped_share").reshape(rows, cols, -1)
    # The third among the neighbours from above; the sample itself comes before them.
    third = scipy.ndimage.rank_filter(image, -4, size=(3, 3, 1))
    return int((glint & (image - third > DOUBTFUL.apart).ravel()).sum())


def _diagnostic(transport: LightTransport, name: str) -> NDArray[np.float64]:
    return np.asarray(transport.diagnostics.get(name, np.zeros(0)), float)


def _mean(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """The weighted mean of what is known; 0 if nothing is."""
    known = np.isfinite(values)
    if not known.any() or not weights[known].sum():
        return 0.0
    return float(np.average(values[known], weights=weights[known]))
