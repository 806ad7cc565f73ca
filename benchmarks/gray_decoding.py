r"""Compare the strongest entries of T with Gray decoding: `python -m benchmarks.gray_decoding`.

The capture (kamino410/procam-calibration) has 20 frames of Gray code stripes and their inverses
along columns, 20 along rows, a white and a black one. The brighter of two frames decodes each bit
of the projector pixel that a lit camera pixel sees, independently of T.

    lightmatrix estimate --patterns BOARD/graycode_pattern --images BOARD/capture_0 \
        --black BOARD/capture_0/graycode_41.png -o board.zarr
    python -m benchmarks.gray_decoding board.zarr BOARD/capture_0
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

import lightmatrix as lm
from experiments.harness import options as options_of
from lightmatrix.estimators.coherent.neighbourhood import strongest_entries
from lightmatrix.files.stacks import ImageStack

# Frames 0 to 19 are ten column bits, the most significant first, each followed by its inverse;
# frames 20 to 39 are ten row bits.
COLUMN_BITS, ROW_BITS, BITS = 0, 20, 10
WHITE, BLACK, CLIP = 40, 41, 255
# A camera pixel is lit if white exceeds black by this share of the clip level. Chosen by hand.
LIT = 0.1
# A place counts as near within this many projector pixels.
NEAR = 2


def decoded(photographs: NDArray[np.float32], first: int) -> NDArray[np.float32]:
    """The projector coordinate that each camera pixel sees, decoded from frame `first` on."""
    ends = first + 2 * BITS
    code = photographs[first:ends:2] > photographs[first + 1 : ends : 2]
    bit = np.zeros(code.shape[1:], bool)
    value = np.zeros(code.shape[1:], np.int64)
    for plane in code:
        bit = bit ^ plane
        value = 2 * value + bit
    return value.astype(np.float32)


def strongest(matrix: csr_array) -> NDArray[np.int64]:
    """The column of each row's largest entry, (rows,); -1 for empty rows."""
    return np.where(np.diff(matrix.indptr) > 0, strongest_entries(matrix), -1)


def compared(stored: lm.StoredTransport, photographs: NDArray[np.float32]) -> dict[str, Any]:
    """Shares of the lit camera pixels whose strongest entry agrees with Gray decoding."""
    lit = (photographs[WHITE] - photographs[BLACK] > LIT * CLIP).ravel()
    places = [decoded(photographs, first).ravel() for first in (ROW_BITS, COLUMN_BITS)]
    columns = np.concatenate([strongest(rows.coefficients) for _, rows in stored.blocks()])
    coordinates = np.divmod(columns, stored.projector_shape[1])
    apart = [np.abs(ours - gray) for ours, gray in zip(coordinates, places, strict=True)]
    distance = np.where(columns < 0, np.inf, np.maximum(*apart))[lit]
    return {
        "lit camera pixels": int(lit.sum()),
        f"within {NEAR} pixels": float((distance <= NEAR).mean()),
        "on it": float((distance == 0).mean()),
        "entries a row": stored.entries / stored.shape[0],
    }


def main(arguments: list[str] | None = None) -> None:
    """Compare, and print the shares."""
    parser = options_of("benchmarks.gray_decoding", __doc__)
    parser.add_argument("matrix", type=Path, help="a store of an estimate at full size")
    parser.add_argument("photographs", type=Path, help="the folder of its 42 photographs")
    options = parser.parse_args(arguments)
    photographs = np.stack(list(ImageStack.open(options.photographs))).astype(np.float32)
    for name, value in compared(lm.StoredTransport.open(options.matrix), photographs).items():
        print(f"{name}: {value:.4g}")


if __name__ == "__main__":
    main()
