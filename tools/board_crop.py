"""Makes tests/data/graycode-board from the sample data of kamino410/procam-calibration.

    python tools/board_crop.py procam-calibration/sample_data tests/data/graycode-board

The photographs are cut to a window, pixel by pixel as they are; the patterns stay whole and are
stored with one bit a pixel, which loses nothing as they are black and white.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

# Four rows of the checkerboard, plain paper, tape with clipped glare, and the unlit table below it.
# A multiple of 8 from the corner, so that blocks of 8 x 8 are those of the whole photograph.
ROWS, COLS = slice(592, 872), slice(248, 632)


def main(source: Path, target: Path) -> None:
    """Write the window of each photograph, and each pattern, under the names they have."""
    for folder in ("graycode_pattern", "capture_0"):
        (target / folder).mkdir(parents=True, exist_ok=True)
        for path in sorted((source / folder).glob("*.png")):
            image = np.asarray(Image.open(path))
            if folder == "capture_0":
                small = Image.fromarray(image[ROWS, COLS])
            else:
                small = Image.fromarray(image > 127)
                if not np.array_equal(np.asarray(small) * np.uint8(255), image):
                    sys.exit(f"{path}: is not black and white")
            small.save(target / folder / path.name, optimize=True)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
