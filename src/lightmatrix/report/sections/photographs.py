"""The photographs: patterns and frames in order, and how many samples clipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.evaluation.judgement import percent
from lightmatrix.pictures.maps import clipping_map
from lightmatrix.report.elements import Bars, Columns, Element, Gallery, Pair, Section, Strip, Table
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import THUMB_PIXELS, image_of_map, pattern_image, photograph

# The first screen shows this many frames, and the whole page at most this many.
FIRST, MOST = 8, 48
# A chart has at most this many bars; of more frames, a bar stands for several.
_BARS = 256


def first_frames(facts: Facts) -> Strip:
    """The first patterns and photographs, which show at a glance whether their order is right."""
    return Strip(tuple(_pair(facts, k) for k in range(min(FIRST, facts.capture.count))))


def photographs(facts: Facts) -> Section:
    """A table of the capture, charts and a map of clipping, and frames."""
    capture = facts.capture
    frames = facts.frames
    maps: list[Element] = []
    if "clipped_share" in facts.transport.diagnostics:
        caption = (
            "Clipping is no error: a clipped sample is a lower bound. But a camera pixel that "
            "clips in nearly every frame carries little information."
        )
        maps.append(Gallery((image_of_map(clipping_map(facts.transport), caption),)))
    rows = tuple((name, str(value)) for name, value in _settings(facts).items())
    table = Table("The capture", ("property", "value"), rows)
    charts = (
        _bars("Clipped samples per frame", frames.clipped),
        _bars("Mean level per frame, relative to the clip level", frames.level),
    )
    elements: list[Element] = [Columns((table, *maps), charts)]
    if capture.count > FIRST:
        shown = np.unique(np.linspace(FIRST, capture.count - 1, MOST - FIRST).astype(int))
        elements.append(Strip(tuple(_pair(facts, int(k)) for k in shown)))
    lead = (
        f"The capture has {capture.count} photographs, one per pattern. "
        f"{percent(float(frames.clipped.mean()))} of the samples clipped."
    )
    if capture.count > MOST:
        lead += f" The page shows {MOST} of them, spread over the capture."
    return Section("photographs", "Patterns and photographs", lead, tuple(elements))


def _settings(facts: Facts) -> dict[str, object]:
    capture = facts.capture
    decoder = capture.decoder
    settings: dict[str, object] = dict(capture.summary())
    settings["clipped samples"] = percent(float(facts.frames.clipped.mean()))
    settings["response"] = decoder.response.name
    settings["black frame"] = "subtracted" if decoder.black_frame is not None else "none"
    if capture.bin_camera != (1, 1):
        settings["camera binning"] = " x ".join(map(str, capture.bin_camera))
    if capture.bin_projector != (1, 1):
        settings["projector binning"] = " x ".join(map(str, capture.bin_projector))
    masked = int((~capture.valid).sum())
    if masked:
        settings["masked camera samples"] = masked
    return settings


def _pair(facts: Facts, index: int) -> Pair:
    capture = facts.capture
    pattern = capture.patterns.images(index, index + 1)[0]
    note = f"{percent(float(facts.frames.clipped[index]))} clip"
    if np.ptp(capture.exposures) > 0:
        note += f", exposure {capture.exposures[index]:g}"
    image = photograph(
        _linear_frame(facts, index), f"Photograph {index}: {note}", white=1.0, most=THUMB_PIXELS
    )
    return Pair(index, pattern_image(pattern, f"Pattern {index}", most=THUMB_PIXELS), image, note)


def _linear_frame(facts: Facts, index: int) -> NDArray[np.float64]:
    """A frame as linear light, 1 at its clip level, with black not subtracted."""
    decoder = facts.capture.decoder
    raw = np.asarray(facts.capture.frame(index), float)
    light = decoder.response.linearise(np.clip(raw / decoder.full_scale, 0, None))
    clip = np.broadcast_to(np.asarray(decoder.clip, float), (facts.capture.count,))[index]
    return np.asarray(light / decoder.response.linearise(clip / decoder.full_scale))


def _bars(title: str, values: NDArray[np.float64]) -> Bars:
    """A chart of one value per frame, or of the largest value of several frames."""
    starts = np.unique(np.linspace(0, len(values), _BARS + 1).astype(int)[:-1])
    largest = np.maximum.reduceat(values, starts)
    top = float(largest.max())
    if len(starts) < len(values):
        title += " (each bar: the largest of neighbouring frames)"
    return Bars(
        title,
        f"From {percent(float(values.min()))} to {percent(float(values.max()))}, median "
        f"{percent(float(np.median(values)))}.",
        tuple(float(value) / max(top, 1e-12) for value in largest),
        percent(top),
        0,
        len(values) - 1,
    )
