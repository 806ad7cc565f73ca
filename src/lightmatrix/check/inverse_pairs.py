"""Captures in which most patterns come with their inverses, as Gray codes do.

A pattern and its inverse add up to white, so the photographs of every pair add up to one and the
same image, whatever the pattern. That reveals more, and more exactly, than any prediction: an odd
frame and motion show as differences between the sums of pairs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.finding import Finding
from lightmatrix.check.motion import find_shift, motion_finding
from lightmatrix.check.survey import Survey
from lightmatrix.check.wrong_frames import black_frames
from lightmatrix.patterns.pattern_set import PatternSet

Floats = NDArray[np.floating]


def find_pairs(patterns: PatternSet) -> NDArray[np.int64]:
    """The frames of each pattern and its inverse, (P, 2); none if most patterns have no inverse."""
    weights = np.random.default_rng(0).standard_normal((1, patterns.pixels))
    sums, white = patterns.forward(weights)[0], float(weights.sum())
    left, pairs = list(range(patterns.count)), list[tuple[int, int]]()
    while left:
        k = left.pop(0)
        # Sums of inverses are exact but for rounding; others are off by the root of the pixels.
        near = 1e-4 * np.sqrt(patterns.pixels)
        inverse = next((j for j in left if abs(sums[k] + sums[j] - white) < near), None)
        if inverse is not None:
            left.remove(inverse)
            # Black and white are a pair that tells nothing more.
            if np.ptp(patterns.rows(k, k + 1)) >= 0.02:
                pairs.append((k, inverse))
    enough = len(pairs) >= max(4, 0.3 * patterns.count)
    return np.array(pairs if enough else [], np.int64).reshape(-1, 2)


def check_pairs(
    survey: Survey, rows: NDArray[np.int64], pairs: NDArray[np.int64], names: Sequence[str]
) -> list[Finding]:
    """Motion and odd frames, by the sums of `pairs` (P, 2) of frames.

    `rows` are high-variance rows.
    """
    moved = _check_motion(survey, pairs, names)
    if moved:
        return moved
    samples = survey.samples(rows)
    light, clipped = samples.values.astype(np.float64)[:, pairs], samples.clipped[:, pairs]
    sums = np.where(clipped.any(axis=2), np.nan, light.sum(axis=2))
    # In some rows, one of each pair is clipped.
    known = ~np.isnan(sums).all(axis=1)
    light, sums = light[known], sums[known]
    white = np.nanmedian(sums, axis=1) if known.any() else np.zeros(0)
    relative = np.clip((sums - white[:, None]) / np.maximum(white, 1e-6)[:, None], -1, 1)
    # Nothing is known of a pair of which one frame clips in all rows.
    oddness = np.sqrt(np.nansum(relative**2, axis=0) / np.maximum((~np.isnan(sums)).sum(axis=0), 1))
    # A pair is odd if its sum differs by 15 % from the usual one, and by 4 times what that of the
    # median pair does.
    odd = oddness > max(0.15, 4 * float(np.median(oddness)))
    if odd.mean() > 0.5:
        return []
    findings = []
    for number in np.flatnonzero(odd):
        pair = pairs[number].tolist()
        sides = [(light[:, number, k], light[:, number, 1 - k]) for k in (0, 1)]
        black = [frame for frame, side in zip(pair, sides, strict=True) if _is_black(*side, white)]
        if black:
            findings.append(black_frames(black[:1], names))
        else:
            message = (
                f"{names[pair[0]]} and {names[pair[1]]}, of a pattern and its inverse, do not add "
                "up to white: one shows something else"
            )
            advice = (
                "look at them: taken during the change of pattern, moved, covered, in another's "
                "place? Take them again"
            )
            findings.append(Finding("frame", tuple(pair), message, advice))
    return _check_moved_part(sums, pairs, names) or findings


def _check_moved_part(
    sums: Floats, pairs: NDArray[np.int64], names: Sequence[str]
) -> list[Finding]:
    """Whether the `sums` of pairs (m, P) change for good in a part of the image, at one pair."""
    order = np.argsort(pairs.min(axis=1))
    known = sums[~np.isnan(sums).any(axis=1)][:, order]
    if not len(known):
        return []
    known = known / np.maximum(np.median(known, axis=1, keepdims=True), 1e-6)
    # Light that changes for all is no motion.
    known /= np.maximum(np.median(known, axis=0), 1e-6)
    shares = []
    for cut in range(2, len(pairs) - 1):
        before, after = known[:, :cut], known[:, cut:]
        step = np.abs(after.mean(axis=1) - before.mean(axis=1))
        rest = np.hypot(before.std(axis=1), after.std(axis=1))
        # Noise, shake and light of the room that grows change the sums from pair to pair.
        shares.append(float((step > np.maximum(0.1, 4 * rest)).mean()))
    # A cut after which most pixels see something else means that whole photographs are odd.
    share = max((each for each in shares if each < 0.3), default=0.0)
    # In intact captures, also of rigs that shake or warm up, up to 0.0017 do. An object that moves,
    # and hides 2 to 6 % of the image, gives 0.01 to 0.07.
    if share < 0.005:
        return []
    first = int(pairs[order[2 + shares.index(share)]].min())
    message = (
        f"from about {names[first]} on, {100 * share:.1f} % of the bright camera pixels see "
        "something else: did a thing move within the scene?"
    )
    frames = tuple(range(first, int(pairs.max()) + 1))
    return [Finding("motion", frames, message, "keep the scene still, and take the capture again")]


def _is_black(light: Floats, partner: Floats, white: Floats) -> bool:
    """Whether a frame is dark where its partner is dark too, by the light of rows, (m,) each."""
    expected, other = float(np.maximum(white - partner, 0).sum()), float(partner.sum())
    # It has less than 10 % of the light that its partner lets expect, but for stray light.
    return bool(light.sum() < min(0.1 * expected + 0.05 * other, 0.3 * other))


def _check_motion(survey: Survey, pairs: NDArray[np.int64], names: Sequence[str]) -> list[Finding]:
    """Whether the sums of pairs lie elsewhere from some pair on."""
    ordered = pairs[np.argsort(pairs.min(axis=1))]
    images = np.empty((len(pairs), len(survey.raw)), np.float32)
    for part, tile in survey.chunks():
        images[:, part] = tile.values[:, ordered].sum(axis=2).T
    shift = find_shift(survey, np.median(images[:3], axis=0), np.median(images[-3:], axis=0))
    if shift is None:
        return []
    moved = [find_shift(survey, images[0], image) is not None for image in images]
    if not moved[-1]:
        return []
    start = int(ordered[moved.index(True)].min())
    when = f"from {names[start]} on, or the frame before or after"
    return [motion_finding(when, start, shift, survey.count)]
