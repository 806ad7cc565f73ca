"""What to photograph: exposures, patterns and their number, advised from a white frame.

The white level w of a camera pixel, the sum of its row of T, bounds each of its entries. Most rows
hold most of w in one spot, lit in half of the random patterns: their samples are near w then, and
near the rest of w otherwise. So what a set of exposures will clip can be told from w alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightmatrix.camera.noise import USUAL_NOISE
from lightmatrix.errors import InputError

# Share of a row's sum in its strongest spot: medians of 0.85, 0.98, 0.89 and 0.43 on the scenes.
SPOT_SHARE = 0.85
# The same of rows that must not clip: they hold more of it where a camera pixel sees no more than
# one projector pixel. (With 0.85 such a rig errs by twice as much, at 1 rows of global light by a
# twentieth more.)
BRIGHT_SPOT_SHARE = 0.9
# Camera pixels below this share of a bright one are not reached by the projector.
_LIT = 0.02
# The brightest pixels that may clip: glints of single pixels must not darken all frames.
GLINTS = 0.001
# Of the light of a typical pixel: noise above it asks for a longer exposure as well.
NOISE_LIMIT = 0.015
# From one exposure to the next.
STEP = 4.0
# Where there are several, the shortest is there for few rows, so that it gets few frames; but with
# less than eight of it bright rows are lost (measured at 16 frames: 4 are too few, 8 suffice).
SHORTEST_SHARE = 0.25
SHORTEST_FRAMES = 8
# Of the white frame's pixels: above, the scene's range is unknown and nothing can be advised.
_MOST_CLIPPED = 0.5
DENSITY = 0.5
# Measured better than 0.5 and 0.1 where single responses clip.
DENSITY_WHERE_CLIPPED = 0.25
# Share of lit camera pixels with a strongest response that clips: above, fewer pixels are lit.
_CLIPPED_SINGLY = 0.01


@dataclass(frozen=True, eq=False)
class WhiteFrame:
    """Camera samples under a white pattern.

    Parameters
    ----------
    levels : (M,) float
        Linear, black subtracted, in units of the clip level, at exposure 1; where clipped, a
        lower bound.
    clipped : (M,) bool
        Which of them clipped.

    Raises
    ------
    InputError
        On a frame that is dark, or clipped in more than half of its lit pixels.
    """

    levels: NDArray[np.floating]
    clipped: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if not self.levels.size or np.quantile(self.levels, 0.99) <= 0:
            raise InputError(
                "the white frame is dark",
                hint="photograph the white pattern with a longer exposure",
            )
        if self.clipped[self.lit].mean() > _MOST_CLIPPED:
            raise InputError(
                f"{100 * self.clipped[self.lit].mean():.0f} % of the white frame is clipped, so "
                "the light of the scene is not known",
                hint="photograph the white pattern with a quarter of the exposure",
            )

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Camera pixels that the projector reaches, (M,) bool."""
        return np.asarray(self.levels > _LIT * np.quantile(self.levels, 0.99))

    @property
    def clipped_share(self) -> float:
        """Share of the lit pixels that clipped."""
        return float(self.clipped[self.lit].mean())

    @property
    def brightest(self) -> float:
        """White level of the brightest pixels, single glints apart."""
        return float(np.quantile(self.levels[self.lit], 1 - GLINTS))

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
    """Exposures and their shares of the frames.

    The shortest puts 90 % of the brightest white level, what a row has in its spot, at the clip
    level, so that no single response and few sums of them clip; these are estimated as clipped
    samples, and what is dim gains more by it than the brightest rows lose. If its noise exceeds
    1.5 % of a typical pixel's light, longer ones follow, four times each, until it does not. Where
    the white frame itself clips, the brightest level is not known; one more exposure, a quarter of
    the shortest, is there for it. Of several exposures the shortest gets a quarter of the frames,
    but 8 at least, and never more than the others.

    Parameters
    ----------
    white : WhiteFrame
    noise : float
        Standard deviation of a sample's noise, as a share of the clip level; >= 0.
    shortest : float, optional
        The camera's shortest exposure, in the unit of the white frame's; > 0.
    frames : int, optional
        Number of frames, for the share of the shortest exposure. None: many.

    Returns
    -------
    list of (exposure, share)
        From the longest to the shortest; in the unit of the white frame's exposure.

    Raises
    ------
    InputError
        On a noise or a shortest exposure out of range.
    """
    check_camera(noise, shortest)
    ladder = [1 / (BRIGHT_SPOT_SHARE * white.brightest)]
    if white.clipped_share > GLINTS:
        ladder.append(ladder[0] / STEP)
    while noise > NOISE_LIMIT * white.typical * ladder[0] and ladder[0] * white.typical < 1:
        ladder.insert(0, STEP * ladder[0])
    if shortest is not None:
        kept = [exposure for exposure in ladder if exposure > shortest]
        ladder = kept if len(kept) == len(ladder) else [*kept, shortest]
    longer = len(ladder) - 1
    least = max(SHORTEST_SHARE, SHORTEST_FRAMES / frames) if frames else SHORTEST_SHARE
    last = min(least, 1 / len(ladder)) if longer else 1.0
    shares = [*[(1 - last) / max(1, longer)] * longer, last]
    return [(_three_digits(e), share) for e, share in zip(ladder, shares, strict=True)]


def _three_digits(exposure: float) -> float:
    """An exposure, > 0, rounded down to three digits, so that nothing clips for its rounding."""
    unit = 10.0 ** (math.floor(math.log10(exposure)) - 2)
    return float(f"{math.floor(exposure / unit * (1 + 1e-12)) * unit:.3g}")


def check_camera(noise: float, shortest: float | None) -> None:
    """Refuse what no camera is like, before a scene is rendered for it.

    Raises
    ------
    InputError
        On a noise outside of [0, 1), or a shortest exposure that is not above 0.
    """
    if not (np.isfinite(noise) and 0 <= noise < 1):
        raise InputError(f"a noise of {noise}", hint="use a share of the clip level, such as 0.003")
    if shortest is not None and not (np.isfinite(shortest) and shortest > 0):
        raise InputError(f"a shortest exposure of {shortest}", hint="use a number above 0")


def clipped_share(white: WhiteFrame, exposure: float, density: float = DENSITY) -> float:
    """Share of samples that will clip under random patterns, told from white levels alone.

    Each row is taken for one spot of 85 % of its sum, lit in a share `density` of the patterns,
    and a broad rest of which the same share is always lit.

    Parameters
    ----------
    white : WhiteFrame
    exposure : float
        In the unit of the white frame's.
    density : float
        Probability that a projector pixel is lit.
    """
    light = exposure * white.levels[white.lit]
    rest = (1 - SPOT_SHARE) * density
    dark, bright = light * rest >= 1, light * (SPOT_SHARE + rest) >= 1
    return float(np.mean((1 - density) * dark + density * bright))


def single_clipped_share(white: WhiteFrame, exposures: Sequence[tuple[float, float]]) -> float:
    """Share of lit camera pixels whose strongest response clips at every exposure."""
    shortest = min(exposure for exposure, _ in exposures)
    return float(np.mean(SPOT_SHARE * shortest * white.levels[white.lit] >= 1))


def advise_density(white: WhiteFrame, exposures: Sequence[tuple[float, float]]) -> float:
    """Share of projector pixels to light: a half, but a quarter where the camera must clip."""
    clipping = single_clipped_share(white, exposures) > _CLIPPED_SINGLY
    return DENSITY_WHERE_CLIPPED if clipping else DENSITY
