"""Errors of measured camera curves against known ones: the table of docs/response.md.

    python -m benchmarks.response_curves [--seeds 3] [--exposures 0.25,1,4]

The simulated photographs have 48 x 64 pixels of a smooth scene with a contrast of 200 : 1. There
are seven exposures, each twice the one before, unless others are given. Noise is 0.3 and 1 % of
full light (growing with the root of the light), black levels are 0 and 20 of 255, and depths are 8
and 12 bits. The table shows the largest error over all levels and photographs, in % of full
light. It takes a minute and needs the extra `response`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import lightmatrix as lm
from experiments.harness import markdown
from experiments.harness import options as options_of
from lightmatrix.responses.curves import CameraResponse

Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]
TIMES: list[float] = [0.125, 0.25, 0.5, 1, 2, 4, 8]


def srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """IEC 61966-2-1."""
    bent = 1.055 * np.maximum(light, 1e-12) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, bent)


def film(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """A contrast curve, as cameras apply it to JPEG files."""
    return 1.17 * light**0.7 / (light**0.7 + 0.3) + 0.1 * light


# Curves from light in [0, 1] to the level as a share of the range.
CURVES: dict[str, Curve] = {
    "linear": lambda light: light,
    "gamma": lambda light: light ** (1 / 2.2),
    "srgb": srgb,
    "film": film,
    "level at white": lambda light: 1 - (1 - light) ** 2,
}


def stack(
    curve: Curve,
    times: Sequence[float],
    *,
    black: int = 0,
    clip: int = 255,
    noise: float = 0.005,
    seed: int = 0,
) -> NDArray[Any]:
    """Photographs of a smooth scene with a contrast of 200 : 1, with noise, clipped and rounded."""
    random = np.random.default_rng(seed)
    scene = gaussian_filter(random.normal(size=(48, 64)), 2)
    scene = np.exp((scene - scene.min()) / np.ptp(scene) * np.log(200) - np.log(200))
    frames = []
    for time in times:
        light = scene * time
        light = light + noise * np.sqrt(0.1 + light) * random.normal(size=scene.shape)
        frames.append(np.rint(black + (clip - black) * curve(np.clip(light, 0, 1))))
    # The contrast curve exceeds 1 a little, where a camera clips.
    levels = np.clip(np.array(frames), 0, 255 if clip < 256 else 65535)
    return levels.astype(np.uint8 if clip < 256 else np.uint16)


def errors(measured: CameraResponse, curve: Curve, black: int, clip: int) -> NDArray[np.float64]:
    """Light of the 256 levels by the measured curve, less that by the known one."""
    response = measured.response
    assert response.light is not None
    assert response.full_scale == clip
    light = np.linspace(0, 1, 100_001)
    share = (np.arange(256) / 255 * clip - black) / (clip - black)
    shape = curve(light) / curve(light[-1:])
    return np.asarray(response.light - np.interp(share, shape, light))


def largest_error(curve: Curve, times: Sequence[float], seeds: int) -> float:
    """The largest error over levels, noises, black levels and depths; a share of full light."""
    worst = 0.0
    for noise, black, clip, seed in itertools.product(
        (0.003, 0.01), (0, 20), (255, 4095), range(seeds)
    ):
        dark = black * (clip + 1) // 256
        photographs = stack(curve, times, black=dark, clip=clip, noise=noise, seed=seed)
        measured = lm.camera_response(photographs, list(times), black=float(dark), clip=float(clip))
        worst = max(worst, float(np.abs(errors(measured, curve, dark, clip)).max()))
    return worst


def main() -> None:
    """Print the table in Markdown."""
    parser = options_of("benchmarks.response_curves", __doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--exposures", default=",".join(map(str, TIMES)))
    arguments = parser.parse_args()
    times = [float(text) for text in arguments.exposures.split(",")]
    lines = []
    for name, curve in CURVES.items():
        share = 100 * largest_error(curve, times, arguments.seeds)
        lines.append([name, f"{share:.1f}"])
    print(markdown(["curve of the camera", "error"], lines))


if __name__ == "__main__":
    main()
