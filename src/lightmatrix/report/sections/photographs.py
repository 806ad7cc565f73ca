"""What was captured: patterns and photographs in order, and how much of them clipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.summary import summarize
from lightmatrix.evaluation.verdict import percent
from lightmatrix.pictures.maps import clipping_map
from lightmatrix.report.elements import Bars, Block, Columns, Gallery, Pair, Section, Strip, Table
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import THUMB_PIXELS, image_of_map, pattern_image, photograph

# Frames on the first screen, and in all.
FIRST, MOST = 8, 48
# Bars of a chart; of more frames than this, a bar stands for several.
_BARS = 256


def order(facts: Facts) -> Strip:
    """The first patterns and photographs: whether their order is right is seen at a glance."""
    return Strip(tuple(_pair(facts, k) for k in range(min(FIRST, facts.capture.count))))


def captured(facts: Facts) -> Section:
    """Facts about the capture, its clipping frame by frame and over the camera, and its frames."""
    capture = facts.capture
    frames = facts.frames
    maps: list[Block] = []
    if "clipped_share" in facts.transport.diagnostics:
        caption = (
            "Clipping is no error: a clipped sample is a lower bound. A camera pixel that clips in "
            "nearly every frame says little."
        )
        maps.append(Gallery((image_of_map(clipping_map(facts.transport), caption),)))
    table = Table(
        "The capture",
        ("what", "value"),
        tuple((name, str(value)) for name, value in _facts(facts).items()),
    )
    charts = (
        _bars("Samples that clipped, frame by frame", frames.clipped),
        _bars("Mean level of each frame, of the clip level", frames.level),
    )
    blocks: list[Block] = [Columns((table, *maps), charts)]
    if capture.count > FIRST:
        shown = np.unique(np.linspace(FIRST, capture.count - 1, MOST - FIRST).astype(int))
        blocks.append(Strip(tuple(_pair(facts, int(k)) for k in shown)))
    lead = (
        f"{capture.count} patterns were projected and photographed in this order; "
        f"{percent(float(frames.clipped.mean()))} of the samples clipped."
    )
    if capture.count > MOST:
        lead += f" {MOST} of them are shown, spread over the capture."
    return Section("captured", "What was captured", lead, tuple(blocks))


def _facts(facts: Facts) -> dict[str, object]:
    capture = facts.capture
    decoder = capture.decoder
    found: dict[str, object] = dict(summarize(capture.patterns, capture.reader))
    found["samples that clipped"] = percent(float(facts.frames.clipped.mean()))
    found["response"] = decoder.response.name
    found["black frame"] = "subtracted" if decoder.black_frame is not None else "none"
    if capture.bin_camera != (1, 1):
        found["camera pixels averaged"] = " x ".join(map(str, capture.bin_camera))
    if capture.bin_projector != (1, 1):
        found["projector pixels averaged"] = " x ".join(map(str, capture.bin_projector))
    left_out = int((~capture.valid).sum())
    if left_out:
        found["camera samples left out"] = left_out
    return found


def _pair(facts: Facts, index: int) -> Pair:
    capture = facts.capture
    pattern = capture.patterns.images(index, index + 1)[0]
    clipped = percent(float(facts.frames.clipped[index]))
    note = f"{clipped} clip"
    if np.ptp(capture.exposures) > 0:
        note += f", exposure {capture.exposures[index]:g}"
    return Pair(
        index,
        pattern_image(pattern, f"Pattern {index}", most=THUMB_PIXELS),
        photograph(
            _shown(facts, index), f"Photograph {index}: {note}", white=1.0, most=THUMB_PIXELS
        ),
        note,
    )


def _shown(facts: Facts, index: int) -> NDArray[np.float64]:
    """A photograph as it was taken, linear, 1 at its clip level."""
    decoder = facts.capture.decoder
    raw = np.asarray(facts.capture.frame(index), float)
    light = decoder.response.linearise(np.clip(raw / decoder.full_scale, 0, None))
    clip = np.broadcast_to(np.asarray(decoder.clip, float), (facts.capture.count,))[index]
    return np.asarray(light / decoder.response.linearise(clip / decoder.full_scale))


def _bars(title: str, values: NDArray[np.float64]) -> Bars:
    """A chart of one value a frame, or of the largest of several frames."""
    starts = np.unique(np.linspace(0, len(values), _BARS + 1).astype(int)[:-1])
    largest = np.maximum.reduceat(values, starts)
    top = float(largest.max())
    if len(starts) < len(values):
        title += ", the largest of some neighbouring frames"
    return Bars(
        title,
        f"From {percent(float(values.min()))} to {percent(float(values.max()))}, "
        f"{percent(float(np.median(values)))} in the median frame.",
        " %",
        tuple(float(value) / max(top, 1e-12) for value in largest),
        percent(top),
        0,
        len(values) - 1,
    )
