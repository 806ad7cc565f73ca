"""Whether there is light enough, and not too much, and whether black and white are so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightmatrix.diagnosis.finding import Finding, listed
from lightmatrix.diagnosis.survey import Survey

# Of all samples that count.
_MOST_CLIPPED = 2 / 3
# Raw levels above black that the brightest samples reach at least.
_FEWEST_LEVELS = 24
# A pixel that varies by less than this share of what lively ones do, or by so many raw levels, has
# not seen the projector.
_STILL, _STILL_LEVELS = 0.05, 3
_MOST_UNSEEN = 0.9
# Patterns are black and white within this. Where in their range, from 0 to 1, pixels are under them
# at most and at least.
_PLAIN = 0.02
_BLACK_AT, _WHITE_AT = 0.15, 0.85
# Of their range that pixels lie below the black frame.
_BELOW_BLACK = 0.08


def unseen_pixels(survey: Survey) -> NDArray[np.bool_]:
    """Which of the samples that count never see the projector, (S,)."""
    known = survey.statistics
    span = known.highest - known.lowest
    usual = float(np.quantile(span[survey.valid], 0.95)) if survey.valid.any() else 0.0
    level = _STILL_LEVELS * _one_level(survey)
    # Clipped in every frame is not unseen.
    dark = (span < max(_STILL * usual, level)) & (known.clipped < 0.5)
    return np.asarray(survey.valid & dark)


def check_light(survey: Survey) -> list[Finding]:
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
    levels = brightest / _one_level(survey)
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
    """Whether frames under black patterns are dark, those under white ones bright.

    Parameters
    ----------
    survey : Survey
    rows : (m,) int
        Lively rows.
    names : sequence of str
        What the frames are called.
    """
    lowest, highest = np.empty(survey.count), np.empty(survey.count)
    for start, block in survey.patterns.chunks():
        lowest[start : start + len(block)] = block.min(axis=1)
        highest[start : start + len(block)] = block.max(axis=1)
    samples = survey.samples(rows)
    bottom = samples.values.min(axis=1, keepdims=True)
    span = np.maximum(samples.values.max(axis=1, keepdims=True) - bottom, 1e-9)
    level = np.median((samples.values - bottom) / span, axis=0)
    found = []
    black, white = highest <= _PLAIN, lowest >= 1 - _PLAIN
    if not (black | white).all():
        bright = np.flatnonzero(black & (level > _BLACK_AT))
        dark = np.flatnonzero(white & (level < _WHITE_AT) & (~samples.clipped).all(axis=0))
        for kind, odd, what in (
            ("black", bright, "black, but the photograph is not the darkest"),
            ("white", dark, "white, but the photograph is not the brightest"),
        ):
            if len(odd):
                found.append(
                    Finding(
                        kind,
                        tuple(int(k) for k in odd),
                        f"the pattern of {listed([names[int(k)] for k in odd])} is {what}",
                        "put the photographs in the order of the patterns, or take it again",
                    )
                )
    # Noise and a single odd frame reach below black too.
    below = float(np.median(-np.quantile(samples.values, 0.1, axis=1) / span[:, 0]))
    if survey.decoder.black_frame is not None and below > _BELOW_BLACK:
        found.append(
            Finding(
                "black",
                (),
                "the black frame is brighter than the photographs where these are dark (by "
                f"{100 * below:.0f} % of their range)",
                "take the black frame with the projector showing black, at the exposure of the "
                "others and in the same room light",
            )
        )
    return found


def _one_level(survey: Survey) -> float:
    """One raw level in units of the clip level, at the longest exposure."""
    decoder = survey.decoder
    span = float(np.max(np.asarray(decoder.clip) - np.asarray(decoder.black_level)))
    longest = float(np.max(decoder.exposure))
    return 1 / (span * longest) if survey.raw.dtype.kind == "u" else 1e-6 / longest
