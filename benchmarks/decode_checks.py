"""Time that `check` takes beside `decode` at 4K: `python -m benchmarks.decode_checks`.

A camera of 2,160 x 3,840 pixels looks at a textured wall, askew, under a Gray code with inverses of
a projector of the same size. Processor seconds of both, in one run; `decode` has its own checks
turned off. First the places are compared with the true ones.
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lightmatrix as lm
from experiments.harness import options as options_of

SIZE = (2160, 3840)


def photographs(patterns: lm.PatternSet) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Photographs (K, rows, cols) of 8 bits, and the place that each camera pixel sees."""
    rows, cols = patterns.shape
    row, col = np.mgrid[:rows, :cols]
    place = np.stack([0.05 * rows + 0.85 * row + 0.02 * col, 0.04 * cols + 0.9 * col - 0.02 * row])
    place = np.clip(place, 0, np.array([rows - 1, cols - 1])[:, None, None])
    at = tuple(np.rint(place).astype(np.int64))
    random = np.random.default_rng(0)
    texture = random.uniform(60, 200, (rows, cols)).astype(np.float32)
    frames = np.empty((patterns.count, rows, cols), np.uint8)
    for k in range(patterns.count):
        noise = random.standard_normal((rows, cols), np.float32)
        frames[k] = np.rint(10 + texture * patterns.images(k, k + 1)[0][at] + noise)
    return frames, place


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print JSON."""
    parser = options_of("benchmarks.decode_checks", __doc__)
    parser.parse_args(arguments)
    patterns = lm.make_patterns("graycode", SIZE, inverse=True)
    frames, place = photographs(patterns)
    capture = lm.Capture.from_arrays(patterns, frames, lm.Sensor(bits=8))
    result: dict[str, Any] = {"frames": patterns.count}
    start = time.process_time()
    matches = lm.decode(capture, check=False)
    result["decode"] = round(time.process_time() - start, 2)
    wrong = np.abs(np.moveaxis(matches.place, -1, 0) - np.rint(place)).max(axis=0) > 1
    result["wrong places"] = float(wrong.mean())
    start = time.process_time()
    result["findings"] = [each.kind for each in lm.check(capture)]
    result["check"] = round(time.process_time() - start, 2)
    result["check over decode"] = round(result["check"] / result["decode"], 2)
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
