"""T as a linear operator: singular values of direct and of global light, and a solver of SciPy.

    python examples/spectrum.py OUT_FOLDER

Singular values tell how many patterns a kind of light can tell apart. Direct light has about as
many large ones as it lights pixels; those of global light fall off after a few, since it is smooth.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.sparse.linalg import aslinearoperator, lsqr, svds

import lightmatrix as lm

PICTURES = {"curves.png": "The 50 largest singular values of a scene's direct and global light"}
COUNT = 50


def main(out: Path) -> tuple[float, float, float]:
    """Write the picture; shares of the 20th value, direct and global; SciPy's relative error."""
    transport = lm.truth("corner").transport()
    parts = lm.separate(transport)
    values = {
        name: np.sort(svds(aslinearoperator(part), COUNT, return_singular_vectors=False))[::-1]
        for name, part in (("direct", parts.direct), ("global", parts.global_))
    }

    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    for name, curve in values.items():
        axes.semilogy(np.arange(1, COUNT + 1), curve, label=f"{name} light")
    axes.set_xlabel("number")
    axes.set_ylabel("singular value (camera full scale)")
    axes.legend()
    figure.savefig(out / "curves.png", dpi=150)
    plt.close(figure)

    # Any method that multiplies with T and its transpose can use it, without a dense matrix.
    shown = np.random.default_rng(0).random(transport.shape[1])
    found = lsqr(transport, transport @ shown, damp=1e-3, iter_lim=30)[0]
    missed = transport @ (found - shown)
    error = float(np.linalg.norm(missed) / np.linalg.norm(transport @ shown))
    direct, others = (float(curve[19] / curve[0]) for curve in values.values())
    return direct, others, error


if __name__ == "__main__":
    print("{:.2f} direct, {:.3f} global; SciPy misses {:.1e}".format(*main(Path(sys.argv[1]))))
