"""Captures from which no estimate can come are refused before any work, with what to do."""

from collections.abc import Iterable

import numpy as np

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.folder import check_depth
from lightmatrix.check.all_checks import check_capture
from lightmatrix.check.finding import Finding
from lightmatrix.errors import InputError, warn


def refuse_unusable(capture: Capture) -> None:
    """Refuse a capture that no estimate can come from, whatever the order of its frames.

    It has one frame only, a projector of one pixel, no pattern that varies, nothing but dark or
    clipped samples, all pixels masked, levels with their two bytes swapped or far below 0, or
    16-bit files of fewer bits, or float files far above 1, without a stated clip level.
    """
    patterns = capture.patterns
    if patterns.count == 1:
        hint = "take at least 2 patterns, better 64 or more"
        raise InputError("the capture has 1 frame only", hint=hint)
    if patterns.pixels == 1:
        hint = "use larger patterns, or bin them less"
        raise InputError("the projector has 1 x 1 pixels", hint=hint)
    # Some patterns may be constant (white, binned stripes). Binning equal pixels may change their
    # last bit.
    first, same = patterns.rows(0, 1), 1e-6
    if not any((np.ptp(part, axis=1) >= same).any() for _, part in patterns.chunks()):
        hint = "use other patterns, or bin the projector less"
        raise InputError("no pattern varies: each shows one grey value all over", hint=hint)
    if not any((np.abs(part - first) >= same).any() for _, part in patterns.chunks()):
        raise InputError("all patterns are the same", hint="use patterns that differ")
    check_depth(capture.frames, capture.decoder)
    valid, decoder = int(capture.valid.sum()), capture.decoder
    if valid == 0:
        hint = "correct the mask, or take a darker black frame"
        raise InputError("all camera pixels are masked", hint=hint)
    brightest, clipped, total = 0.0, 0, 0
    for _, tile in capture.tiles():
        level = np.broadcast_to(tile.clip_level, tile.values.shape)
        # The level of a pixel that clips without light is 0. It is masked, and has no light.
        shares = np.divide(tile.values, level, out=np.zeros_like(tile.values), where=level > 0)
        brightest = max(brightest, float(shares.max(initial=0)))
        clipped += int(tile.clipped.sum())
        total = valid * tile.values.shape[1]
    span = np.min(np.asarray(decoder.clip) - np.asarray(decoder.black_level))
    # Two raw levels above black are no signal.
    if brightest <= (2.5 / span if decoder.full_scale > 1 else 1e-6):
        hint = "expose longer, and check the black frame and black level"
        raise InputError("all images are dark: no sample rises above the black level", hint=hint)
    if clipped > 0.99 * total:
        hint = "expose so that most samples stay below the clip level; 1 to 20 % may clip"
        raise InputError(f"{100 * clipped / total:.1f} % of the samples are clipped", hint=hint)


def refuse_unordered(capture: Capture) -> list[Finding]:
    """Refuse a capture whose photographs do not follow their patterns, which spoils all of T.

    Returns what else `check` finds.
    """
    findings = check_capture(capture)
    for finding in findings:
        if finding.kind in ("order", "unrelated", "interchanged"):
            hint = f"{finding.advice}; check=False takes them as they are"
            raise InputError(finding.message, hint=hint)
    return findings


def warn_of(findings: Iterable[Finding]) -> None:
    """Warn of each finding by itself."""
    for finding in findings:
        warn(f"{finding.kind}: {finding.message}\n  {finding.advice}")
