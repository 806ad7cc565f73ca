"""Relight a scene, and see it from the projector, with an exactly known T.

    python examples/relight_and_dual.py OUT_FOLDER

The image under any pattern is a product with T. The transpose of T gives the scene as the projector
would photograph it, lit from the camera (dual photography, Sen et al. 2005).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm

PICTURES = {
    "relit.png": "The scene under stripes that were never projected",
    "dual.png": "The scene as the projector sees it",
    "row.png": "How much light each projector pixel sends to one camera pixel",
}


def main(out: Path) -> None:
    """Write the three pictures."""
    transport = lm.truth("l_objects").transport()

    stripes = np.zeros(transport.projector_shape, np.float32)
    stripes[:, ::8] = 1
    # The pattern beside what the camera sees, at an exposure at which hardly a pixel clips.
    both = np.hstack([stripes, 0.6 * transport.relight(stripes)])
    enlarged = np.kron(both.clip(0, 1) ** (1 / 2.2), np.ones((6, 6)))
    lm.write_image(out / "relit.png", enlarged)

    # In the dual image, every camera pixel is a light.
    lm.show(transport, "dual").savefig(out / "dual.png")
    lm.show(transport, "row", 40, 30).savefig(out / "row.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
