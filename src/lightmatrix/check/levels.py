"""What the raw levels of photographs reveal by themselves: too much light, too little, JPEG.

JPEG rounds the cosine transform of each block of 8 x 8 pixels to multiples of a step, one for each
of the 64 frequencies. Rounding again by the same steps changes hardly anything, even where levels
were cut off at the ends of the range: photographs that are compressed again at the same quality
come out nearly as they went in, and at no other quality. A camera with its own table of steps
shows as coefficients that lie on combs.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile

from lightmatrix.capture.clip_level import find_pile
from lightmatrix.check.finding import Finding, join_names
from lightmatrix.check.survey import BLOCK, Survey, bright_mean
from lightmatrix.files.images import encode_image
from lightmatrix.patterns.codes import Code

# A frequency needs as many coefficients for a comb.
_FEWEST_COEFFICIENTS = 40


def check_light_level(survey: Survey, codes: Sequence[Code] = ()) -> list[Finding]:
    """Too much light, or too little; `codes` are those of stripes."""
    known, valid = survey.statistics, survey.valid
    if not valid.any():
        message = "no camera pixel counts: all are masked, or clipped in the black frame"
        return [Finding("light", (), message, "correct the mask, or take a darker black frame")]
    clipped = float(known.clipped[valid].mean())
    # Places by stripes are uncertain wherever they clip, or where both a bit and its inverse do. In
    # `corner`, `l_objects`, `metal` and `gripper`, a fifth of such pixels changes hardly a depth.
    most = 0.5 * (1 + 1 / survey.count) if all(code.paired for code in codes) else 0
    uncertain = float((known.clipped[valid] > most).mean()) if codes else 0
    if clipped > 2 / 3 or uncertain > 0.2:
        advice = "expose shorter, until a white pattern just does not clip (`plan` finds how long)"
        message = f"{100 * clipped:.0f} % of the samples are clipped"
        if uncertain > 0.2:
            message += f": the places that {100 * uncertain:.0f} % of the pixels see are uncertain"
        return [Finding("light", (), message, advice)]
    brightest = float(np.quantile(known.highest[valid], 0.999))
    levels = brightest / survey.one_level
    # Noise of one level would be 4 % of 24.
    if survey.raw.dtype.kind == "u" and levels < 24:
        message = f"the brightest samples reach {max(levels, 0):.0f} raw levels above black"
        advice = "expose longer or open the aperture; check the black frame and the black level"
        return [Finding("light", (), message, advice)]
    return []


def check_clip_level(survey: Survey) -> tuple[list[Finding], Survey]:
    """Whether samples pile up below the clip level; and the survey that clips there."""
    pile, decoder = find_pile(survey.raw), survey.decoder
    clip = np.float32(np.min(decoder.clip))
    if pile is None or not np.max(decoder.black_level) < pile.level < clip:
        return [], survey
    message = f"{pile}, and hardly any are above: they seem to clip there, not at {clip:g}"
    advice = f'give clip={pile.shown}, or "clip" in capture.json'
    if survey.raw.dtype == np.uint8 and pile.level == 235:
        advice += "; video has black_level=16, too"
    return [Finding("clip", (), message, advice)], replace(
        survey, decoder=replace(decoder, clip=float(pile.shown))
    )


def check_saturated(survey: Survey, name: Callable[[int], str]) -> list[Finding]:
    """Whether single frames clip all over, although their patterns are not white.

    They reveal nothing, and look like any pattern.
    """
    valid = survey.valid
    if not valid.any():
        return []
    clipped = np.zeros(survey.count)
    for part, tile in survey.chunks():
        clipped += tile.clipped[valid[part]].sum(axis=0)
    clipped /= valid.sum()
    exposures = np.broadcast_to(survey.decoder.exposure, survey.count)
    found = []
    for k in np.flatnonzero((clipped > 0.95) & (survey.patterns.means < 0.9)):
        # If most frames of an exposure clip, the exposure is too long, which other checks say. If
        # another one clips nearly all over, patterns are coarse, and the camera sees a white part.
        others = clipped[(exposures == exposures[k]) & (clipped <= 0.95)]
        if len(others) and np.median(others) < 0.5 and others.max() < 0.8:
            found.append(int(k))
    if not found:
        return []
    message = f"{join_names([name(k) for k in found])}: white, although the pattern is not"
    return [Finding("frame", tuple(found), message, "take it again, without other light")]


def check_two_levels(survey: Survey, rows: NDArray[np.int64]) -> list[Finding]:
    """Whether high-variance rows show two levels only, which every curve of the camera explains.

    Levels at several exposures, and a curve that was measured, leave no doubt.
    """
    decoder = survey.decoder
    if np.ptp(decoder.exposure) > 0 or decoder.response.name != "linear":
        return []
    values = survey.samples(rows).values
    lowest, highest = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    lit = values > (lowest + highest) / 2
    bright, dark = (
        (values * part).sum(axis=1, keepdims=True) / np.maximum(part.sum(axis=1, keepdims=True), 1)
        for part in (lit, ~lit)
    )
    spread = np.sqrt(((values - np.where(lit, bright, dark)) ** 2).mean(axis=1, keepdims=True))
    # On eleven scenes under nine kinds of patterns, all rows are so where a camera pixel sees one
    # projector pixel, and hardly any elsewhere; but most are under single projector pixels.
    if np.mean(spread < 0.05 * (bright - dark)) < 0.9:
        return []
    where = ", nor where they clip" if decoder.clip_assumed else ""
    message = (
        "camera pixels show two levels only, as where each sees a single projector pixel: whether "
        f"the photographs are linear in light could not be tested{where}"
    )
    advice = (
        "measure the curve (`lightmatrix response`) and state it, or photograph half of the "
        "patterns at another exposure"
    )
    return [Finding("linearity", (), message, advice)]


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
    # In dim rows, noise decides which frame is the brightest.
    lit = span[:, 0] > 0.2 * bright_mean(span)
    level = np.median(((samples.values - bottom) / span)[lit], axis=0)
    findings = []
    # Grey values differ by 2 % at most in black and white patterns. Under them the median pixel
    # must lie in the lowest or highest 15 % of its own range.
    black, white = highest <= 0.02, lowest >= 0.98
    if not (black | white).all():
        bright = np.flatnonzero(black & (level > 0.15))
        dark = np.flatnonzero(white & (level < 0.85) & (~samples.clipped).all(axis=0))
        for kind, odd, most in (("black", bright, "darkest"), ("white", dark, "brightest")):
            if len(odd):
                which = join_names([names[int(k)] for k in odd])
                message = f"the pattern of {which} is {kind}, but the photograph is not the {most}"
                advice = "put the photographs in the order of the patterns, or take it again"
                findings.append(Finding(kind, tuple(map(int, odd)), message, advice))
    # The lowest tenth, since noise and a single odd frame reach below black too.
    below = float(np.median(-np.quantile(samples.values, 0.1, axis=1) / span[:, 0]))
    if survey.decoder.black_frame is not None and below > 0.08:
        message = (
            "the black frame is brighter than the photographs where these are dark (by "
            f"{100 * below:.0f} % of their range)"
        )
        advice = (
            "take the black frame with the projector showing black, at the exposure of the others "
            "and in the same room light"
        )
        findings.append(Finding("black", (), message, advice))
    return findings


def check_jpeg(survey: Survey, names: Sequence[str]) -> list[Finding]:
    """Whether the raw levels were rounded as JPEG does, in frames of 8 bits and a block or more."""
    if survey.raw.dtype != np.uint8 or min(survey.grid[1:3]) < BLOCK:
        return []
    frames = np.unique(np.linspace(0, survey.count - 1, 8).astype(int))
    images = np.moveaxis(survey.raw[:, frames].reshape(*survey.grid, len(frames)), -1, 0)
    blocks = _blocks(images)
    quality = likely_quality(blocks)
    step = None if quality else comb_step(blocks)
    if not quality and step is None:
        return []
    how = f"of quality {quality}" if quality else f"with steps of about {step:.0f} levels"
    message = f"the photographs went through JPEG {how}"
    if not names[0].lower().endswith((".jpg", ".jpeg")):
        message += ", whatever their files are now"
    advice = (
        "save raw or lossless files (PNG, TIFF) in the camera's own software; if there is only "
        "JPEG, take its best quality, and state the response srgb if it is not linear"
    )
    return [Finding("jpeg", (), message, advice)]


def likely_quality(blocks: NDArray[np.floating]) -> int | None:
    """The quality at which libjpeg's table compressed blocks (n, 8, 8) of levels, if any."""
    if len(blocks) < _FEWEST_COEFFICIENTS:
        return None
    coefficients = scipy.fft.dctn(blocks - 128, axes=(1, 2), norm="ortho")
    # From quality 96 on steps are 1 and photographs as good as lossless.
    qualities, change = range(20, 96), []
    for quality in qualities:
        # The steps for luminance that libjpeg writes into a file of this quality.
        coded = encode_image(np.zeros((BLOCK, BLOCK), np.uint8), "jpeg", quality=quality)
        table = JpegImageFile(io.BytesIO(coded)).quantization[0]
        steps = np.reshape(table, (BLOCK, BLOCK)).astype(np.float32)
        again = (
            scipy.fft.idctn(steps * np.rint(coefficients / steps), axes=(1, 2), norm="ortho") + 128
        )
        change.append(float(np.mean((np.rint(again).clip(0, 255) - blocks) ** 2)))
    # Photographs that were never compressed change less and less as the quality rises. At the
    # quality of the first time they change by less than 60 % of what they do at 5 more or less.
    for k in range(5, len(change) - 5):
        near = change[k - 5 : k + 6]
        if change[k] == min(near) and change[k] < 0.6 * min(near[0], near[-1]):
            return qualities[k]
    return None


def comb_step(blocks: NDArray[np.floating]) -> float | None:
    """The median step of the combs that blocks (n, 8, 8) of levels lie on; None if on none."""
    # Levels that were cut off lie on no comb.
    blocks = blocks[(blocks.min(axis=(1, 2)) > 0) & (blocks.max(axis=(1, 2)) < 255)]
    if not len(blocks):
        return None
    coefficients = scipy.fft.dctn(blocks, axes=(1, 2), norm="ortho").reshape(-1, BLOCK * BLOCK)
    # Rounding to whole levels hides steps below 3 levels.
    all_steps = np.arange(3, 128)
    frequencies, combs = 0, []
    # The mean of a block, the first, is left out: flat areas put it on a comb by chance.
    for values in np.abs(coefficients.T[1:]).astype(np.float32):
        # A comb of only one tooth, at zero, is a smooth image.
        beyond = values > all_steps[:, None] / 2
        count = beyond.sum(axis=1)
        steps = all_steps[count >= _FEWEST_COEFFICIENTS]
        waves = np.cos((2 * np.pi / steps).astype(np.float32)[:, None] * values)
        # Coefficients follow a comb by the cosine of their distance to the next tooth; by chance
        # its mean is 0.
        followed = (waves * beyond[: len(steps)]).sum(axis=1) / count[: len(steps)] > 0.5
        frequencies += bool(len(steps))
        if followed.any():
            combs.append(float(steps[followed][-1]))
    if len(combs) >= max(6, frequencies / 2):
        return float(np.median(combs))
    return None


def _blocks(images: NDArray[Any]) -> NDArray[np.floating]:
    """Some of the blocks of luminance that are not uniform, (n, 8, 8)."""
    # JPEG codes the luminance first.
    weights = [0.299, 0.587, 0.114] if images.shape[-1] == 3 else [1]
    light = images @ np.array(weights, np.float32)
    frames, tiles, rows, cols = light.shape
    rows, cols = rows // BLOCK * BLOCK, cols // BLOCK * BLOCK
    cut = light[:, :, :rows, :cols].reshape(frames, tiles, -1, BLOCK, cols // BLOCK, BLOCK)
    blocks = cut.transpose(0, 1, 2, 4, 3, 5).reshape(-1, BLOCK, BLOCK)
    chosen = np.flatnonzero(np.ptp(blocks, axis=(1, 2)) > 2)
    # More blocks take longer.
    return blocks[np.random.default_rng(0).permutation(chosen)[:3000]]
