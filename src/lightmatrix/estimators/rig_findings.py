"""`lm.check`: what is wrong with the photographs of a capture, and what the rig did meanwhile."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lightmatrix import estimators
from lightmatrix.capture.camera_curve import AUTOMATIC, Response
from lightmatrix.capture.capture import Capture, Crop
from lightmatrix.capture.found_response import with_response
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.check.all_checks import check_source
from lightmatrix.check.finding import Finding
from lightmatrix.check.refusals import refuse_unusable
from lightmatrix.errors import InputError
from lightmatrix.estimators.camera_window import window_of_levels
from lightmatrix.patterns.colour import ColourPatterns
from lightmatrix.patterns.pattern_set import PatternSet
from lightmatrix.patterns.stripes import is_separable
from lightmatrix.rig_model.terms import TERMS

# After these findings T cannot be estimated, or it shows them in place of what the rig did.
_SPOILING = ("files", "counts", "interchanged", "order", "unrelated", "frame", "motion", "clip")
# Fewer than 12 frames reveal nothing of the rig. Of more than 256, only so many are looked at:
# estimates from more hold no frames out, without which no fault is certain.
_FEWEST_FRAMES, _MOST_FRAMES = 12, 256


def check(
    capture: Capture | str | Path | None = None,
    *,
    patterns: str | Path | PatternSet | None = None,
    images: str | Path | None = None,
    settings: ReadSettings | None = None,
    crop: Crop | None = None,
) -> list[Finding]:
    """Find what is wrong with a capture, as `lightmatrix check` does.

    It looks at number and sizes of the files, frames that are swapped, lost, late, black or odd,
    lossy compression, motion, too much or too little light, and patterns that cannot reveal all of
    T. Then it estimates T in a part of the camera, and finds what the rig did in the course of the
    capture, as `fit_rig` does.

    Parameters
    ----------
    capture : Capture, str or Path, optional
        A capture, or its folder, packed or not. Its photographs are looked at as they were taken,
        whatever is binned; what the rig did is found in binned ones. None: two plain folders.
    patterns : str, Path or PatternSet, optional
    images : str or Path, optional
        The two folders, or stacks; see `Capture.from_folders`.
    settings : ReadSettings, optional
        How the images of the two folders are read. None: as those of a linear camera.
    crop : ((int, int), (int, int)), optional
        Corner and shape of the rectangle of the photographs that is looked at. None: all of them.

    Returns
    -------
    list of Finding
        Faults, then notes. Fewer than 12 frames, and scenes without direct light, reveal little
        about order, motion and the rig.

    Raises
    ------
    InputError
        On folders that are none, and descriptions that contradict themselves.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32), exposure=0.2)
    >>> lm.check(capture)
    []
    >>> frames = np.stack([capture.frame(k) for k in (0, 2, 1, *range(3, 32))])
    >>> mixed = lm.Capture.from_arrays(capture.patterns, frames, capture.sensor)
    >>> [finding.message for finding in lm.check(mixed)]
    ['frame 1 and frame 2 look swapped']
    """
    findings, read = check_source(capture, patterns, images, settings, crop)
    if read is not None:
        findings += rig_findings(read, findings)
    return sorted(findings, key=lambda finding: finding.is_note)


def rig_findings(
    capture: Capture, known: Sequence[Finding] = (), terms: Sequence[str] = tuple(TERMS)
) -> list[Finding]:
    """What the rig did in the course of a capture, by an estimate in a part of the camera.

    `known` is what else was found. Where T cannot be estimated from random patterns, or holds no
    photographs out, nothing is found.
    """
    patterns, kinds = capture.patterns, {each.kind for each in known}
    if (
        kinds.intersection(_SPOILING)
        or capture.count < _FEWEST_FRAMES
        or isinstance(patterns, ColourPatterns)
        or is_separable(patterns)
        # A T that the photographs determine explains whatever the rig does.
        or patterns.inverted is not None
    ):
        return []
    if "jpeg" in kinds:
        # JPEG rounds dark and bright samples by different steps, which looks like a curve.
        terms = [each for each in terms if each != "camera-curve"]
    part = window_of_levels(capture, 45)
    # A curve that is to be found is no fault.
    unknown = {"projector-curve"} if capture.projector_unknown else set[str]()
    if part.decoder.response.name == AUTOMATIC:
        part = with_response(part, Response())
        unknown.add("camera-curve")
    if part.count > _MOST_FRAMES:
        part = part.select(np.linspace(0, part.count - 1, _MOST_FRAMES).astype(int))
    try:
        refuse_unusable(part)
        estimator = estimators.choice.choose_estimator(part)
        correct = estimators.corrected.corrected
        model, _ = correct(part, estimator.estimate(part), estimator.estimate, terms)
    except InputError:
        return []
    terms_found = [(TERMS[name](), values) for name, values in model.values.items()]
    found = [Finding(t.label_of(v), (), t.sentence(v), t.advice) for t, v in terms_found]
    return [each for each in found if each.kind not in kinds | unknown]
