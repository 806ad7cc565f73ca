"""From two plain folders of images to T, with a report of how well that went.

    python examples/own_photographs.py OUT_FOLDER

The folders are what a projector and a camera leave behind: patterns as they were projected, and
photographs in the same order. Here the photographs are simulated; put your own in their place.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "clipping.png": "How many of each camera pixel's samples clipped",
    "white.png": "The scene under a white pattern, computed from T",
}


def main(out: Path) -> dict[str, object]:
    """Write patterns and photographs, estimate T from them, and write the report."""
    patterns = lm.BernoulliPatterns((64, 64), 32)
    lm.write_patterns(out / "patterns", patterns)
    photographed = lm.simulate("metal", patterns, exposure=0.3)
    for k in range(photographed.count):
        lm.write_image(out / "photos" / f"photo_{k:04d}.png", photographed.frame(k))

    # Your own work begins here.
    capture = lm.Capture.from_folders(out / "patterns", out / "photos")
    estimate = lm.estimate(capture, output=out / "scene.zarr")
    told = lm.report(out / "report", estimate, capture)
    print(f"{told['verdict']}: {told['sentence']}")

    lm.show_clipping(estimate).savefig(out / "clipping.png")
    white = np.ones(estimate.projector_shape)
    lm.show_relit(estimate, white).savefig(out / "white.png")
    return told


if __name__ == "__main__":
    main(Path(sys.argv[1]))
