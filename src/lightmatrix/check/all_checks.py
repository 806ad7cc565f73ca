"""All checks of photographs as such, in memory or on disk, also of some that cannot be opened.

Later checks use what earlier ones found. `lm.check` (`estimators/rig_findings.py`) adds what the
rig did in the course of the capture.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture, Crop
from lightmatrix.capture.folder import check_depth, read_capture, read_folders
from lightmatrix.capture.frames import CaptureParts
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.check import code_order, levels
from lightmatrix.check.code_frames import check_brightness, check_grey_values, check_uniform
from lightmatrix.check.finding import Finding, join_names
from lightmatrix.check.inverse_pairs import check_pairs, find_pairs
from lightmatrix.check.motion import check_motion
from lightmatrix.check.prediction import predict
from lightmatrix.check.relation import Relation, check_relation, check_unseen
from lightmatrix.check.survey import Survey, high_variance_rows
from lightmatrix.check.wrong_frames import LIKELY, SUSPECT, check_frames, wrong_frames
from lightmatrix.errors import InputError
from lightmatrix.files.stacks import ImageStack
from lightmatrix.patterns.inverse import lights_one
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet
from lightmatrix.patterns.stripes import is_separable
from lightmatrix.resources.threads import one_blas_thread, side_by_side

# Fewer frames, or fewer camera pixels that can be predicted, tell no fault from chance.
_FEWEST_FRAMES, _FEWEST_ROWS = 12, 20
# A photograph has at least so many different levels, since it has noise; drawn images have fewer.
_NOISY = 24
# If more than a quarter of the frames are odd, the cause is not in single frames.
_MOST_ODD = 0.25


def check_source(
    capture: Capture | str | Path | None,
    patterns: str | Path | PatternSet | None,
    images: str | Path | None,
    settings: ReadSettings | None,
    crop: Crop | None,
) -> tuple[list[Finding], Capture | None]:
    """What `lm.check` finds in photographs as such, and the capture, if all of it can be read."""
    if isinstance(capture, Capture):
        return _check_read(capture, crop), capture
    if capture is not None:
        parts = read_capture(capture, counted=False)
    elif patterns is not None and images is not None:
        parts = read_folders(patterns, images, settings or ReadSettings(), counted=False)
    else:
        hint = "give a capture folder, or patterns and images"
        raise InputError("there is nothing to check", hint=hint)
    try:
        if parts.patterns.count != parts.frames.count:
            return _check_uncounted(parts), None
        parts.decoder.check_count(parts.frames.count)
        read = Capture(**vars(parts))
        return _check_read(read, crop), read
    except InputError:
        unread = _unread(parts)
        if unread:
            return unread, None
        raise


def _check_read(whole: Capture, crop: Crop | None) -> list[Finding]:
    """What is wrong with a capture, of which all frames must be readable."""
    findings = check_capture(whole if crop is None else whole.crop(*crop))
    try:
        check_depth(whole.frames, whole.decoder)
    except InputError as error:
        # Nothing else is known as long as levels are misread.
        return [Finding("files", (), error.message, error.hint or "")]
    return findings


def _check_uncounted(parts: CaptureParts) -> list[Finding]:
    """What can be found although the numbers of patterns and frames differ."""
    decoder, survey = parts.decoder, None
    # Frames are read if one of them may be missing. Nobody knows which of the levels that differ
    # from frame to frame belong to which frame.
    one_less = parts.frames.count == parts.patterns.count - 1
    if one_less and not any(
        np.ndim(getattr(decoder, key)) for key in ("clip", "black_level", "exposure")
    ):
        survey = Survey.take(parts.patterns, parts.frames, decoder, parts.mask)
    # Frames that lie packed have no files.
    paths = parts.frames.paths if isinstance(parts.frames, ImageStack) else ()
    images = [Path(entry.name) for entry in paths]
    counts = check_counts(survey, parts.patterns.count, images)
    return [counts, *check_distinguishable(parts.patterns)]


def check_counts(survey: Survey | None, patterns: int, images: Sequence[Path]) -> Finding:
    """State that the numbers differ, and, with a survey of all, which photograph is missing."""
    count = len(images)
    message = f"{patterns} patterns, but {count} photographs"
    frames = missing_places(survey) if survey is not None and count == patterns - 1 else ()
    digits = ["".join(c for c in path.stem if c.isdecimal() and c.isascii()) for path in images]
    numbers = [int(each) for each in digits if each]
    whole = range(min(numbers, default=0), max(numbers, default=0) + 1)
    gaps = whole.stop - whole.start - len({*numbers})
    # Names count in steps, and have no gaps, if they leave out more than a quarter.
    if gaps and len(numbers) == count and 4 * gaps <= count:
        absent = sorted({*whole}.difference(numbers))
        message += f"; their names leave out number {', '.join(map(str, absent[:5]))}"
        # A single gap is better evidence than what the photographs look like.
        if gaps == 1 and count == patterns - 1 and numbers == sorted(numbers):
            place = whole.index(absent[0])
            frames = (place,) if place in frames else (place, *frames)
    if frames:
        which = " or ".join(map(str, frames))
        message += f": that of pattern {which} (counted from 0) is missing"
        if len(frames) == 1 and frames[0] < count:
            message += f", before {images[frames[0]].name}"
    advice = (
        "take it again, or leave the pattern out too"
        if count < patterns
        else "remove what is no photograph of a pattern: a test shot, a frame taken twice, the "
        "black frame?"
    )
    return Finding("counts", frames, message, advice)


def missing_places(survey: Survey) -> tuple[int, ...]:
    """Which of K patterns may have no frame among K - 1 frames; empty if unknown."""
    patterns, count = survey.patterns, survey.count
    lattice = code_order.CodeLattice.of(survey)
    if lattice is not None:
        return code_order.missing_of_code(lattice)
    # Frames after the missing one show the pattern after that of their number.
    first = replace(survey, patterns=patterns.subset(np.arange(count)))
    place = size = 0
    while place == size < count:
        relation = Relation.of(first, size)
        if count < 16 or relation is None:
            return ()
        excess, place, step = relation.displaced(0)
        size = relation.first + len(relation.frames)
        if excess < 6 or step < 0:
            return ()
    return (place,)


def _unread(parts: CaptureParts) -> list[Finding]:
    """A finding for each reason why some frames cannot be read or do not fit the first."""
    problems: dict[str, tuple[list[int], InputError]] = {}
    paths = parts.frames.paths if isinstance(parts.frames, ImageStack) else ()
    for k, path in enumerate(paths):
        try:
            parts.frames.read(k)
        except InputError as error:
            # Files with the same problem are one finding.
            reason = error.message.replace(str(path), "")
            problems.setdefault(reason, ([], error))[0].append(k)
    findings = []
    for frames, first in problems.values():
        more = f", and {len(frames) - 1} more like it" if len(frames) > 1 else ""
        advice = first.hint or "take the photograph again, or save it again"
        findings.append(Finding("files", tuple(frames), first.message + more, advice))
    return findings


def check_capture(capture: Capture) -> list[Finding]:
    """Everything that seems wrong with a capture.

    Frames are looked at as they were taken, whatever is binned. Of a rectangle of the photographs,
    only the light is judged: whether frames are in order, or something moved, shows better in whole
    photographs.
    """
    with one_blas_thread():
        survey = _survey(capture.whole)
        findings = check_interchanged(survey) or levels.check_saturated(survey, capture.frames.name)
        if findings:
            return findings
        # What follows judges by the level at which the photographs do clip, and by the pixels that
        # see the projector.
        of_clip, survey = levels.check_clip_level(survey)
        unseen, survey = check_unseen(survey)
        if capture.whole is not capture:
            unseen, _ = check_unseen(_survey(capture))
        copies = check_copies(survey, capture.frames.name)
        found = of_clip + unseen + _check_surveyed(survey, capture, copies)
        ordered = {k for each in found for k in each.frames if each.kind == "order"}
        copies = [each for each in copies if not ordered.intersection(each.frames)]
        copied = {k for each in copies for k in each.frames}
        known = [each for each in found if each.kind == "frame" and copied.issuperset(each.frames)]
        return [each for each in found if each not in known] + copies


def _check_surveyed(survey: Survey, capture: Capture, copies: list[Finding]) -> list[Finding]:
    names = [capture.frames.name(k) for k in range(capture.count)]
    rows = high_variance_rows(survey)

    def of_light() -> list[Finding]:
        seen = survey if capture.whole is capture else _survey(capture)
        found = check_distinguishable(survey.patterns)
        found += levels.check_light_level(seen, lattice.codes.codes if lattice else ())
        if lattice is not None and not displaced:
            found += code_order.check_mirrored(lattice)
        return found + levels.check_jpeg(survey, names)

    lattice, pairs = code_order.CodeLattice.of(survey), find_pairs(survey.patterns)
    # A white photograph, or a black one, would seem to be in the wrong place. Where patterns come
    # with inverses, the sums of pairs tell which one it is.
    uniform = list[Finding]()
    if lattice and not len(pairs) and lattice.possible(np.arange(survey.count)).all():
        uniform = check_uniform(lattice, names.__getitem__)
    displaced = (
        code_order.check_code_order(lattice, names.__getitem__) if lattice and not uniform else []
    )
    # Stripes tell that two photographs are alike, and not which one is in the other's place.
    copied = {k for each in copies for k in each.frames}
    if any(each.frames and copied.issuperset(each.frames) for each in displaced):
        displaced = copies
    # Two frames may seem swapped for another reason, which later checks may find. Two that show the
    # same are certainly wrong.
    two_swapped = len(displaced) == 1 and len(displaced[0].frames) == 2
    alike = lattice is not None and any(each.frames in lattice.twins for each in displaced)
    few = survey.count < _FEWEST_FRAMES or len(rows) < _FEWEST_ROWS

    def of_code(found: list[Finding]) -> list[Finding]:
        """What stripes tell of single frames, if it is more than what was found."""
        moved = any(each.kind in ("order", "motion", "unrelated") for each in found + displaced)
        if lattice is None or moved or len(pairs):
            return found
        name = names.__getitem__
        of_one = uniform or check_brightness(lattice, name)
        return of_one or found or check_grey_values(lattice)

    if few or alike or (displaced and not two_swapped):
        return of_light() + displaced + of_code([])

    # Each of them keeps about one core busy.
    findings, unrelated = side_by_side(
        [of_light, lambda: check_relation(survey, names.__getitem__)]
    )
    if len(pairs):
        of_frames = unrelated or _check_by_pairs(survey, rows, names, pairs, displaced)
        displaced = []
    else:
        of_frames = of_code(_check_by_prediction(survey, rows, names, unrelated))
    # Motion, and a black frame, make neighbours see as distant places as a swap does.
    kinds = ("order", "motion")
    if displaced and not any(e.kind in kinds or "black" in e.message for e in of_frames):
        return findings + displaced
    # Photographs of another series or scene are no reason to measure the camera's curve.
    if not any(each.kind in (*kinds, "unrelated") for each in of_frames):
        of_frames += levels.check_two_levels(survey, rows)
    return findings + of_frames


def _survey(capture: Capture) -> Survey:
    # Stripes are decoded in seconds, and checking them shall take no longer.
    share = 0.25 if is_separable(capture.patterns) else 1
    return Survey.take(capture.patterns, capture.frames, capture.decoder, capture.mask, share)


def check_distinguishable(patterns: PatternSet) -> list[Finding]:
    """Whether the patterns can tell several footprints in a row, and single pixels, apart."""
    if is_separable(patterns):
        message = "stripes suffice for correspondence and shape (`decode`), but not for all of T"
        advice = (
            "for T project random patterns too: where a pixel sees several places, stripes cannot "
            "tell them from the crossings of their rows and columns"
        )
        return [Finding("stripes", (), message, advice)]
    unlit = int((patterns.squares == 0).sum()) if lights_one(patterns) else 0
    if unlit:
        message = f"{unlit} of the {patterns.pixels} projector pixels are lit by no pattern"
        advice = "T holds nothing of their light, and cannot relight with them: light each once"
        return [Finding("unlit", (), message, advice)]
    advice = "project more patterns, or finer ones, or bin the projector"
    # Under random patterns, not one pair of neighbours in a hundred differs by less than a quarter
    # of what independent pixels do; under the 256 coarsest of 1,024 Hadamard patterns half do.
    near = min(patterns.shape) > 1 and float(np.mean(_neighbour_contrasts(patterns) < 0.25))
    if near > 0.2:
        message = (
            f"{100 * near:.0f} % of the neighbouring projector pixels look nearly alike: the "
            "patterns are too coarse to tell them apart"
        )
        return [Finding("patterns", (), message, advice)]
    alike = float(np.mean(np.bincount(patterns.twins)[patterns.twins] > 1))
    # Few random patterns leave pixels alike by chance: 16 of them 22 % of 128 x 128 pixels, which
    # their neighbours tell apart.
    lit = float(np.mean(patterns.means))
    pair = (lit**2 + (1 - lit) ** 2) ** patterns.count
    chance = -np.expm1(-(patterns.pixels - 1) * pair)
    if alike < 0.2 + min(float(chance), 0.3):
        return []
    message = (
        f"{100 * alike:.0f} % of the projector pixels look like another: all patterns show the "
        "same there"
    )
    return [Finding("patterns", (), message, advice)]


def _neighbour_contrasts(patterns: PatternSet) -> NDArray[np.float64]:
    """Squared differences of neighbouring pixels, relative to independent ones, (1024,)."""
    random, (rows, cols) = np.random.default_rng(0), patterns.shape
    pixels = random.integers(rows - 1, size=512) * cols + random.integers(cols - 1, size=512)
    pairs = np.stack([np.tile(pixels, 2), np.append(pixels + 1, pixels + cols)])
    values = patterns.at(pairs) - patterns.means[:, None, None]
    independent = np.square(values).sum(axis=(0, 1))
    return np.square(values[:, 0] - values[:, 1]).sum(axis=0) / np.maximum(independent, 1e-12)


def check_interchanged(survey: Survey) -> list[Finding]:
    """Whether the patterns look photographed and the photographs drawn."""
    patterns = survey.patterns
    if not isinstance(patterns, ImagePatterns):
        return []
    frames = range(min(4, survey.count))
    # Projected images have up to 4 grey values.
    drawn = all(len(np.unique(survey.raw[:, k])) <= 4 for k in frames)
    noisy = all(len(np.unique(patterns.rows(k, k + 1))) >= _NOISY for k in frames)
    if not (drawn and noisy):
        return []
    message = "the photographs have a few exact grey values, and the patterns have noise"
    advice = "patterns and photographs seem to be in each other's place: exchange the folders"
    return [Finding("interchanged", (), message, advice)]


def check_copies(survey: Survey, name: Callable[[int], str]) -> list[Finding]:
    """Which photographs are the same to the last level, although their patterns differ."""
    alike: dict[bytes, list[int]] = {}
    for k in range(survey.count):
        alike.setdefault(sha256(survey.raw[:, k].tobytes()).digest(), []).append(k)
    findings = []
    for frames in (each for each in alike.values() if len(each) > 1):
        shown = (survey.patterns.rows(k, k + 1) for k in frames)
        first, raw = next(shown), survey.raw[:, frames[0]]
        # Photographs that are dark all over, or clip, show no noise. Rendered ones have none
        # either: they are alike if all that the camera sees of their patterns is white, or black.
        ends = [bool((raw == end(axis=1)).all()) for end in (survey.raw.min, survey.raw.max)]
        alike_patterns = all(np.array_equal(first, other) for other in shown)
        if len(np.unique(raw)) < _NOISY or ends[0] != ends[1] or alike_patterns:
            continue
        message = (
            f"{join_names([name(k) for k in frames])} are the same photograph, to the last level, "
            "although their patterns differ"
        )
        advice = "take again those that do not show their patterns; a copied file?"
        findings.append(Finding("order", tuple(frames), message, advice))
    return findings


def _check_by_pairs(
    survey: Survey,
    rows: NDArray[np.int64],
    names: Sequence[str],
    pairs: NDArray[np.int64],
    disorder: list[Finding],
) -> list[Finding]:
    """Checks of patterns that come with their inverses; `disorder` is that of stripes."""
    findings = levels.check_plain_frames(survey, rows, names)
    of_pairs = check_pairs(survey, rows, pairs, names)
    # One black or spoilt frame, and motion, look like a swap. It is one if pairs add up once both
    # frames are exchanged.
    if disorder and of_pairs and not any("black" in each.message for each in of_pairs):
        order = np.arange(survey.count)
        for each in disorder:
            order[list(each.frames)] = each.frames[::-1]
        exchanged = check_pairs(survey.select_frames(order), rows, pairs, names)
        if not any(each.kind in ("frame", "motion") for each in exchanged):
            return findings + disorder + exchanged
    # A pattern and its inverse add up, in whatever order.
    of_one_pair = [each for each in disorder if list(each.frames) in np.sort(pairs).tolist()]
    if not of_pairs and of_one_pair:
        return findings + of_one_pair
    return findings + of_pairs


def _check_by_prediction(
    survey: Survey, rows: NDArray[np.int64], names: Sequence[str], unrelated: list[Finding]
) -> list[Finding]:
    """Checks of patterns that have nothing to do with each other."""
    order = [each for each in unrelated if each.kind == "order"]
    exchanged = sorted({k for each in order for k in each.frames})
    if order and not 0 < len(exchanged) < _MOST_ODD * survey.count:
        return order
    findings = order + levels.check_plain_frames(survey, rows, names)
    samples = survey.samples(rows)
    # Learned from all frames: few that show something else hardly mislead it.
    first = predict(survey.patterns, samples)
    odd, usual = np.zeros(survey.count, bool), first.rows(first.predicted)
    if len(usual.miss) >= _FEWEST_ROWS:
        odd = wrong_frames(usual, SUSPECT)
        odd &= odd.mean() < _MOST_ODD
    odd[exchanged] = True
    moved = check_motion(survey, rows, odd, names)
    if moved:
        return findings + moved
    # Photographs of which half are shifted may seem unrelated to their patterns, too.
    if unrelated and not order:
        return unrelated
    # Judged by the frames that are not suspected.
    prediction = predict(survey.patterns, samples, doubted=odd) if odd.any() else first
    if prediction.predicted.sum() < _FEWEST_ROWS:
        return findings
    wrong = wrong_frames(prediction.rows(prediction.predicted))
    # Without a frame, its rows may be explained by other places; then it seems wrong only now.
    both = wrong & wrong_frames(usual, LIKELY) if len(usual.miss) else wrong
    both[exchanged] = False
    # The photograph of a black pattern is dark, whatever the others let expect.
    both[survey.patterns.means < 0.01] = False
    # The light of a pixel that no other pattern shows follows from no other photograph.
    if not lights_one(survey.patterns):
        findings += check_frames(prediction.rows(prediction.predicted), both, names)
    return findings
