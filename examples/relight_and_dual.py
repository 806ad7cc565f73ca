"""Relight a scene and look at it from the projector, with an exactly known T.

    python examples/relight_and_dual.py OUT_FOLDER

Writes relit.png (stripes that were never projected), dual.png (the scene as the projector sees it)
and row.png (how each projector pixel reaches one camera pixel).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from lightmatrix.files.images import write_image
from lightmatrix.rig import library


def main(out: Path) -> None:
    """Write the three pictures."""
    transport = library.truth("l_objects").transport()

    stripes = np.zeros(transport.projector_shape, np.float32)
    stripes[:, ::8] = 1
    relit = transport.relight(stripes)
    write_image(out / "relit.png", np.clip(relit, 0, 1))

    # Every camera pixel a light: the dual image shows what the projector would photograph.
    dual = transport.dual(np.ones(transport.camera_shape, np.float32))
    write_image(out / "dual.png", np.clip(dual / np.quantile(dual, 0.99), 0, 1))

    row = transport.row(40, 30)
    write_image(out / "row.png", np.clip(row / row.max(), 0, 1) ** 0.25)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
