"""Paint with light: strokes on the projector, and the photograph that they give.

    python examples/painting.py OUT_FOLDER

A column of T is the photograph of one lit projector pixel, so that the photograph of a brush stroke
is a sum of columns, which a browser adds while the brush moves. `lightmatrix view` paints a store
this way; here a page is written that needs neither server nor network, to send or to publish.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "painted.png": "A ring painted on the projector, and what the camera sees of it",
}


def main(out: Path) -> None:
    """Write the picture, and the page to paint on."""
    transport = lm.truth("metal").transport()

    rows, cols = np.indices(transport.projector_shape)
    ring = abs(np.hypot(rows - 30, cols - 32) - 18) < 4
    # The pattern beside what the camera sees, at an exposure at which hardly a pixel clips.
    both = np.hstack([ring, 0.4 * transport.relight(ring.astype(np.float32))])
    enlarged = np.kron(both.clip(0, 1) ** (1 / 2.2), np.ones((6, 6)))
    lm.write_image(out / "painted.png", enlarged)

    lm.export_viewer(out / "page.html", transport)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
