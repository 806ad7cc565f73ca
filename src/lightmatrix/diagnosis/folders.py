"""Checks of captures in memory and on disk, also of those that no estimate could open."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightmatrix.capture.capture import Capture, Crop
from lightmatrix.capture.decoding import CaptureParts
from lightmatrix.capture.folder import read_capture, read_folders
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.diagnosis.all_checks import check_capture
from lightmatrix.diagnosis.counts import check_counts
from lightmatrix.diagnosis.finding import Finding
from lightmatrix.diagnosis.pattern_faults import check_distinguishable
from lightmatrix.diagnosis.survey import Survey
from lightmatrix.errors import InputError
from lightmatrix.files.stacks import ImageStack, Page
from lightmatrix.patterns.pattern_set import PatternSet


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
    the response, lossy compression, motion, flicker, too much or too little light, and patterns
    that cannot reveal all of T.

    Parameters
    ----------
    capture : Capture, str or Path, optional
        A capture, looked at as it was taken whatever is binned; or a capture folder, packed or
        not. None: two plain folders.
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
        Empty if nothing seems wrong. Fewer than 12 frames, and scenes without direct light, reveal
        little about order, motion and flicker.

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
    if isinstance(capture, Capture):
        return check_capture(capture if crop is None else capture.crop(*crop))
    if capture is not None:
        return _check_parts(read_capture(capture, counted=False), crop)
    if patterns is None or images is None:
        raise InputError(
            "there is nothing to check", hint="give a capture folder, or patterns and images"
        )
    parts = read_folders(patterns, images, settings or ReadSettings(), counted=False)
    return _check_parts(parts, crop)


def _check_parts(parts: CaptureParts, crop: Crop | None) -> list[Finding]:
    try:
        if parts.patterns.count != parts.frames.count:
            return _check_uncounted(parts)
        parts.decoder.check_count(parts.frames.count)
        whole = Capture(**vars(parts))
        return check_capture(whole if crop is None else whole.crop(*crop))
    except InputError:
        unread = _unread(parts)
        if unread:
            return unread
        raise


def _check_uncounted(parts: CaptureParts) -> list[Finding]:
    """What can be found although the numbers of patterns and frames differ."""
    decoder, images = parts.decoder, [Path(entry.name) for entry in _paths(parts)]
    survey = None
    # Nobody knows which of the levels that differ from frame to frame belong to which frame.
    if not any(np.ndim(getattr(decoder, key)) for key in ("clip", "black_level", "exposure")):
        survey = Survey.take(parts.patterns, parts.frames, decoder, parts.mask)
    return [
        check_counts(survey, parts.patterns.count, images),
        *check_distinguishable(parts.patterns),
    ]


def _paths(parts: CaptureParts) -> tuple[Path | Page, ...]:
    """The files of the frames; none if they lie packed."""
    return parts.frames.paths if isinstance(parts.frames, ImageStack) else ()


def _unread(parts: CaptureParts) -> list[Finding]:
    """A finding for each reason why some frames cannot be read or do not fit the first."""
    problems: dict[str, tuple[list[int], InputError]] = {}
    for k, path in enumerate(_paths(parts)):
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
