"""Whether there is enough light, not too much, and the right amount in black and white frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, join_names
from lightmatrix.diagnosis.survey import Survey

# The capture has too much light if two thirds of its samples clip, and too little if its brightest
# thousandth does not reach 24 raw levels above black: noise of one level would be 4 %.
_MOST_CLIPPED = 2 / 3
_FEWEST_LEVELS = 24
# A camera pixel has not seen the projector if it varies by less than 5 % of what the most varied
# 5 % of the pixels do, or by less than 3 raw levels. Nearly no pixel may see it: 90 % unseen.
_STILL, _STILL_LEVELS = 0.05, 3
_MOST_UNSEEN = 0.9
# A pattern is black or white if all of it is within 2 % of that. Under it the median pixel must lie
# in the lowest or highest 15 % of its own range.
_PLAIN = 0.02
_DARKEST, _BRIGHTEST = 0.15, 0.85
# The black frame is too bright if pixels fall below it by 8 % of their range.
_BELOW_BLACK = 0.08


def unseen_pixels(survey: Survey) -> NDArray[np.bool_]:
    """Which samples count but never see the projector, (S,); some must count."""
    known = survey.statistics
    span = known.highest - known.lowest
    usual = float(np.quantile(span[survey.valid], 0.95))
    level = _STILL_LEVELS * one_level(survey)
    # A pixel that always clips does not vary either, but sees too much.
    still = (span < max(_STILL * usual, level)) & (known.clipped < 0.5)
    return np.asarray(survey.valid & still)


def check_light_level(survey: Survey) -> list[Finding]:
    """Too much light, too little, or nearly everywhere none from the projector."""
    known, valid = survey.statistics, survey.valid
    if not valid.any():
        return [
            Finding(
                "light",
                (),
                "no camera pixel counts: all are masked, or clipped in the black frame",
                "correct the mask, or take a darker black frame",
            )
        ]
    clipped = float(known.clipped[valid].mean())
    if clipped > _MOST_CLIPPED:
        return [
            Finding(
                "light",
                (),
                f"{100 * clipped:.0f} % of the samples are clipped",
                "expose shorter, or close the aperture: best is when a white pattern just does not "
                "clip (`lightmatrix plan white.png`)",
            )
        ]
    brightest = float(np.quantile(known.highest[valid], 0.999))
    levels = brightest / one_level(survey)
    if survey.raw.dtype.kind == "u" and levels < _FEWEST_LEVELS:
        return [
            Finding(
                "light",
                (),
                f"the brightest samples reach {max(levels, 0):.0f} raw levels above black",
                "expose longer or open the aperture; check the black frame and the black level",
            )
        ]
    unseen = float(unseen_pixels(survey).sum() / valid.sum())
    if unseen > _MOST_UNSEEN:
        return [
            Finding(
                "unseen",
                (),
                f"{100 * unseen:.0f} % of the camera pixels never see light of the projector",
                "move camera or lens so that the lit part fills the image, or leave the rest out "
                "(--crop, --mask)",
            )
        ]
    return []


def check_plain_frames(
    survey: Survey, rows: NDArray[np.int64], names: Sequence[str]
) -> list[Finding]:
    """Whether high-variance rows are dark under black patterns, and bright under white ones."""
    lowest, highest = np.empty(survey.count), np.empty(survey.count)
    for start, block in survey.patterns.chunks():
        lowest[start : start + len(block)] = block.min(axis=1)
        highest[start : start + len(block)] = block.max(axis=1)
    samples = survey.samples(rows)
    bottom = samples.values.min(axis=1, keepdims=True)
    span = np.maximum(samples.values.max(axis=1, keepdims=True) - bottom, 1e-9)
    level = np.median((samples.values - bottom) / span, axis=0)
    findings = []
    black, white = highest <= _PLAIN, lowest >= 1 - _PLAIN
    if not (black | white).all():
        bright = np.flatnonzero(black & (level > _DARKEST))
        dark = np.flatnonzero(white & (level < _BRIGHTEST) & (~samples.clipped).all(axis=0))
        for kind, odd, what in (
            ("black", bright, "black, but the photograph is not the darkest"),
            ("white", dark, "white, but the photograph is not the brightest"),
        ):
            if len(odd):
                findings.append(
                    Finding(
                        kind,
                        tuple(int(k) for k in odd),
                        f"the pattern of {join_names([names[int(k)] for k in odd])} is {what}",
                        "put the photographs in the order of the patterns, or take it again",
                    )
                )
    # The lowest tenth, since noise and a single odd frame reach below black too.
    below = float(np.median(-np.quantile(samples.values, 0.1, axis=1) / span[:, 0]))
    if survey.decoder.black_frame is not None and below > _BELOW_BLACK:
        findings.append(
            Finding(
                "black",
                (),
                "the black frame is brighter than the photographs where these are dark (by "
                f"{100 * below:.0f} % of their range)",
                "take the black frame with the projector showing black, at the exposure of the "
                "others and in the same room light",
            )
        )
    return findings


def one_level(survey: Survey) -> float:
    """One raw level in units of the clip level at the longest exposure; a millionth of floats."""
    decoder = survey.decoder
    span = float(np.max(np.asarray(decoder.clip) - np.asarray(decoder.black_level)))
    longest = float(np.max(decoder.exposure))
    return 1 / (span * longest) if survey.raw.dtype.kind == "u" else 1e-6 / longest
