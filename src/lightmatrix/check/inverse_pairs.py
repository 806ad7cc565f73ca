"""Captures in which most patterns come with their inverses, as Gray codes do.

A pattern and its inverse add up to white, so the photographs of every pair add up to one and the
same image, whatever the pattern. That reveals more, and more exactly, than any prediction: an odd
frame, light that changed and motion show as differences between the sums of pairs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.finding import STEADY_LIGHT, Finding, odd_light
from lightmatrix.check.motion import find_shift, motion_finding
from lightmatrix.check.survey import Survey, bright_mean, robust_deviation
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
    """Motion, odd frames and light that changes, by the sums of `pairs` (P, 2) of frames.

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
    light, clipped, sums = light[known], clipped[known], sums[known]
    white = np.nanmedian(sums, axis=1) if known.any() else np.zeros(0)
    relative = np.clip((sums - white[:, None]) / np.maximum(white, 1e-6)[:, None], -1, 1)
    # Nothing is known of a pair of which one frame clips in all rows.
    oddness = np.sqrt(np.nansum(relative**2, axis=0) / np.maximum((~np.isnan(sums)).sum(axis=0), 1))
    # A pair is odd if its sum differs by 15 % from the usual one, and by 4 times what that of the
    # median pair does.
    odd = oddness > max(0.15, 4 * float(np.median(oddness)))
    if odd.mean() > 0.5:
        return []
    findings, gains = [], []
    for number, (pair, bad) in enumerate(zip(pairs.tolist(), odd, strict=True)):
        sides = [(light[:, number, k], light[:, number, 1 - k]) for k in (0, 1)]
        black = [frame for frame, side in zip(pair, sides, strict=True) if _is_black(*side, white)]
        if not bad:
            both = zip(pair, sides, clipped[:, number].T, strict=True)
            gains += [(k, *_gain(*side, white, ~hidden)) for k, side, hidden in both]
        elif black:
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
    frames, change, error = map(np.array, zip(*gains, strict=True))
    return findings + _check_gains(change, error, frames, names)


def _is_black(light: Floats, partner: Floats, white: Floats) -> bool:
    """Whether a frame is dark where its partner is dark too, by the light of rows, (m,) each."""
    expected, other = float(np.maximum(white - partner, 0).sum()), float(partner.sum())
    # It has less than 10 % of the light that its partner lets expect, but for stray light.
    return bool(light.sum() < min(0.1 * expected + 0.05 * other, 0.3 * other))


def _gain(
    light: Floats, partner: Floats, white: Floats, known: NDArray[np.bool_]
) -> tuple[float, float]:
    """How much brighter a frame is than its partner lets expect, as a share, and its error."""
    expected = white - partner
    # In dim pixels, noise decides which of the two frames is the brighter one.
    lit = known & (expected > 0.6 * white) & (white > 0.2 * bright_mean(white))
    if lit.sum() < 20:
        return 0.0, np.inf
    # However many they are, they are only as exact as cameras are linear.
    expected, total = expected[lit], expected[lit].sum()
    change = light[lit] - expected
    gain = float(change.sum() / total)
    return gain, float(np.hypot(0.004, np.linalg.norm(change - gain * expected) / total))


def _check_gains(
    change: Floats, error: Floats, frames: NDArray[np.int64], names: Sequence[str]
) -> list[Finding]:
    """Whether the light of some of the `frames` (k,), or of all, changes by more than its error."""
    certain, usual = np.abs(change) > 5 * error, robust_deviation(change)
    # A standard deviation of the light of up to 1.2 % does no harm.
    if usual > 0.012 and certain.mean() > 0.3:
        spread = 100 * float(np.sqrt(np.mean(np.clip(change, -4 * usual, 4 * usual) ** 2)))
        # Sums of pairs that are not linear in light look like changes of the light.
        message = (
            f"the light varies from frame to frame by {spread:.1f} % (standard deviation), or the "
            "photographs are not linear in light"
        )
        return [Finding("gain", (), message, f"{STEADY_LIGHT}, or the camera's gamma")]
    odd = np.flatnonzero(certain & (np.abs(change) > max(0.04, 6 * usual)))
    if not len(odd):
        return []
    message = odd_light({names[frames[k]]: change[k] for k in odd})
    return [Finding("gain", tuple(map(int, frames[odd])), message, STEADY_LIGHT)]


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
