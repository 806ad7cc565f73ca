"""Exposures and density of patterns, advised from a white frame.

The white level w of a camera pixel is the sum of its row of T and bounds each of its entries. Most
rows hold most of w in one spot, which is lit in half of the random patterns. Their samples are near
w if it is lit and near the rest of w otherwise. So w alone predicts what will clip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.errors import InputError
from lightmatrix.ranges import as_float

# Random patterns light this share of the projector pixels.
DENSITY = 0.5


@dataclass(frozen=True)
class _Rules:
    """What the advice assumes of scenes; `python -m benchmarks.exposures` compares exposures."""

    # The strongest spot of a row is assumed to hold this share of its sum. The medians on the four
    # bundled scenes are 0.85, 0.98, 0.89 and 0.43.
    spot: float = 0.85
    # Rows that must not clip are assumed to hold this share in their spot. It is higher where a
    # camera pixel sees no more than one projector pixel: with 0.85 such a rig has twice the error.
    # With 1, rows of global light have a twentieth more error.
    bright_spot: float = 0.9
    # The projector does not reach camera pixels below this share of a bright one (0.99 quantile).
    lit: float = 0.02
    # This share of the lit pixels, the brightest, may clip: glints must not darken all frames.
    glints: float = 0.001
    # If the noise exceeds this share of a typical pixel's light, longer exposures are added, each
    # by this factor.
    noise: float = 0.015
    step: float = 4.0
    # The shortest of several exposures serves few rows and gets this share of the frames, but at
    # least this many. Measured at 16 frames: with 4 of them bright rows are lost, 8 suffice.
    shortest_share: float = 0.25
    shortest_frames: int = 8
    # If the strongest response of more than this share of the lit camera pixels clips, half as many
    # projector pixels are lit. Where a fifth of them clips so, a density of 0.25 is better than 0.5
    # and 0.1 (docs/planning.md, "Density").
    clipped_singly: float = 0.01


RULES = _Rules()


@dataclass(frozen=True, eq=False)
class WhiteFrame:
    """Samples under white; refuses dark frames and those that clip mostly."""

    # (M,), linear, black subtracted, in clip levels at exposure 1; lower bounds if clipped.
    levels: NDArray[np.floating]
    clipped: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if not self.levels.size or np.quantile(self.levels, 0.99) <= 0:
            hint = "photograph the white pattern with a longer exposure"
            raise InputError("the white frame is dark", hint=hint)
        if self.clipped_share > 0.5:
            raise InputError(
                f"{100 * self.clipped_share:.0f} % of the white frame is clipped, so "
                "the light of the scene is unknown",
                hint="photograph the white pattern with a quarter of the exposure",
            )

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Camera pixels that the projector reaches, (M,) bool."""
        return np.asarray(self.levels > RULES.lit * np.quantile(self.levels, 0.99))

    @property
    def clipped_share(self) -> float:
        """Share of the lit pixels that clipped."""
        return float(self.clipped[self.lit].mean())

    @property
    def brightest(self) -> float:
        """White level of the brightest pixels, except for glints."""
        return float(np.quantile(self.levels[self.lit], 1 - RULES.glints))

    @property
    def typical(self) -> float:
        """White level of the median lit pixel."""
        return float(np.median(self.levels[self.lit]))


def advise_exposures(
    white: WhiteFrame,
    noise: float = USUAL_NOISE,
    shortest: float | None = None,
    frames: int | None = None,
) -> list[tuple[float, float]]:
    """Exposures (in the white frame's unit, the longest first) and their shares of the frames.

    The shortest exposure puts 90 % of the brightest white level, the spot of that row, at the clip
    level, so that no single response and few sums clip: dim rows gain more from it than the
    brightest lose. While `noise` (a share of the clip level) exceeds 1.5 % of a typical pixel's
    light, longer exposures are added, four times each. Where the white frame itself clips, one of a
    quarter of the shortest is added. The shortest of several gets a quarter of the frames, at least
    8, but never more than the others. `shortest` is the camera's own limit.
    """
    check_camera(noise, shortest)
    ladder = [1 / (RULES.bright_spot * white.brightest)]
    if white.clipped_share > RULES.glints:
        ladder.append(ladder[0] / RULES.step)
    while noise > RULES.noise * white.typical * ladder[0] and ladder[0] * white.typical < 1:
        ladder.insert(0, RULES.step * ladder[0])
    if shortest is not None:
        kept = [exposure for exposure in ladder if exposure > shortest]
        ladder = kept if len(kept) == len(ladder) else [*kept, shortest]
    longer = len(ladder) - 1
    least = RULES.shortest_share
    if frames:
        least = max(least, RULES.shortest_frames / frames)
    last = min(least, 1 / len(ladder)) if longer else 1.0
    shares = [*[(1 - last) / max(1, longer)] * longer, last]
    # Rounded down to three digits, so that rounding makes nothing clip.
    units = [10.0 ** (math.floor(math.log10(exposure)) - 2) for exposure in ladder]
    rounded = [math.floor(e / u * (1 + 1e-12)) * u for e, u in zip(ladder, units, strict=True)]
    return [(float(f"{e:.3g}"), share) for e, share in zip(rounded, shares, strict=True)]


def check_camera(noise: float, shortest: float | None) -> None:
    """Raise InputError on an impossible camera, before a scene is rendered for it."""
    if not 0 <= as_float(noise) < 1:
        raise InputError(f"a noise of {noise}", hint="use a share of the clip level, such as 0.003")
    if shortest is not None and not 0 < as_float(shortest) < math.inf:
        raise InputError(f"a shortest exposure of {shortest}", hint="use a number above 0")


def clipped_share(white: WhiteFrame, exposure: float, density: float = DENSITY) -> float:
    """Share of samples that will clip under random patterns, predicted from white levels alone.

    Each row is modelled as one spot of 85 % of its sum, lit in a share `density` of the patterns,
    and a broad rest of which the same share is always lit.
    """
    light = exposure * white.levels[white.lit]
    rest = (1 - RULES.spot) * density
    dark, bright = light * rest >= 1, light * (RULES.spot + rest) >= 1
    return float(np.mean((1 - density) * dark + density * bright))


def single_clipped_share(white: WhiteFrame, exposures: Sequence[tuple[float, float]]) -> float:
    """Share of lit camera pixels whose strongest response clips at every exposure."""
    shortest = min(exposure for exposure, _ in exposures)
    return float(np.mean(RULES.spot * shortest * white.levels[white.lit] >= 1))


def advise_density(white: WhiteFrame, exposures: Sequence[tuple[float, float]]) -> float:
    """Share of projector pixels to light: a half, or a quarter if single responses clip."""
    clipping = single_clipped_share(white, exposures) > RULES.clipped_singly
    return DENSITY / 2 if clipping else DENSITY
