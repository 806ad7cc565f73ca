"""Relight a scene and look at it from the projector, with an exactly known T.

    python examples/relight_and_dual.py OUT_FOLDER

Writes relit.png (stripes that were never projected), dual.png (the scene as the projector sees it)
and row.png (how each projector pixel reaches one camera pixel).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lightmatrix as lm


def main(out: Path) -> None:
    """Write the three pictures."""
    transport = lm.truth("l_objects").transport()

    stripes = np.zeros(transport.projector_shape, np.float32)
    stripes[:, ::8] = 1
    lm.relight(transport, stripes, gamma=2.2, output=out / "relit.png")

    # Every camera pixel a light: the dual image shows what the projector would photograph.
    lm.show_dual(transport).savefig(out / "dual.png")
    lm.show_row(transport, 40, 30).savefig(out / "row.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
