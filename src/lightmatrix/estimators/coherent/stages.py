"""Which camera pixels are solved when, and where each of them looks for light.

In a small frame every camera pixel first looks at every projector pixel. The cost of that grows
with the product of both. In a large frame only seeds do, every sixteenth camera pixel both ways.
They settle among themselves, then light grows from neighbour to neighbour, as PatchMatch does for
stereo (Barnes et al. 2009): onto every fourth camera pixel, onto all. Camera pixels whose own
samples are not explained then look everywhere for themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

# Frames are large from so many camera samples times projector pixels on; 128 x 128 of both, in
# colour too, are below.
LARGE = 1 << 30
# Every so-manieth camera pixel both ways is solved, in the first of these rows of steps for which
# the camera is large enough. The first round of a step reaches two camera pixels far, so that steps
# by more than 4 would leave gaps.
SPACINGS = ((16, 4, 1), (8, 4, 1), (4, 1))
STEP_REACH = 2
# With fewer seeds along a side they would have no neighbours to speak of.
FEWEST_SEEDS = 16
# Of each finer step, so many rounds come after the one in which light grows onto it.
SETTLING = 4
# After so many of its rounds, a step's rows that are not explained look everywhere.
GROWN = 2
# What neighbours' rows give is expected from this round on: then most rows are about right.
EXPECTING = 3


@dataclass(frozen=True)
class Stage:
    """A round over some camera pixels.

    Parameters
    ----------
    spacing : int
        Every so-manieth camera pixel both ways.
    window : (int, int), optional
        Half widths of the windows, in camera and in projector pixels. None: rows look at every
        projector pixel, each for itself.
    age : int
        Rounds that these rows, or those that they grow from, have behind them.
    last : bool
        Whether what comes out is the result.
    again : bool
        Whether rows that are not explained look everywhere.
    still : bool
        Whether rows stay as they are where nothing changed around them in the round before.
    """

    spacing: int
    window: tuple[int, int] | None
    age: int
    last: bool = False
    again: bool = False
    still: bool = False

    @property
    def expecting(self) -> bool:
        """Whether neighbours' rows stand in for samples that clip or were never taken."""
        return self.age >= EXPECTING


def stages(
    camera: tuple[int, ...], pixels: int, windows: tuple[tuple[int, int], ...]
) -> tuple[Stage, ...]:
    """All rounds in turn; those of a small frame are its windows, after the look everywhere.

    Parameters
    ----------
    camera : (rows, columns, ...)
        Of the camera.
    pixels : int
        Of the projector.
    windows : tuple of (int, int)
        Half widths of the windows of each round of a small frame.
    """
    first, *finer = spacings(camera, pixels, windows)
    settled = windows[:-1] if finer else windows
    found = [Stage(first, None, 0)]
    found += [Stage(first, window, age) for age, window in enumerate(settled, start=1)]
    for spacing in finer:
        own = (windows[0], *windows[-SETTLING:])
        if spacing > 1:
            own = (windows[0], *windows[-SETTLING - 1 : -1])
        grown = min(GROWN, len(own) - 1)
        for i, window in enumerate(own):
            still = i >= grown and window == own[i - 1]
            found.append(Stage(spacing, window, EXPECTING + i, again=i + 1 == grown, still=still))
    last = found.pop()
    return (*found, Stage(last.spacing, last.window, last.age, last=True))


def is_large(samples: int, pixels: int) -> bool:
    """Whether a frame of so many camera samples is too large for all to look everywhere."""
    return samples * pixels > LARGE


def spacings(
    camera: tuple[int, ...], pixels: int, windows: tuple[tuple[int, int], ...]
) -> tuple[int, ...]:
    """The steps, from the seeds to all camera pixels; (1,) of a small frame."""
    rows, cols, *channels = camera
    samples = rows * cols * (channels[0] if channels else 1)
    if not is_large(samples, pixels) or windows[0][0] < STEP_REACH:
        return (1,)
    side = min(rows, cols)
    return next((steps for steps in SPACINGS if side >= steps[0] * FEWEST_SEEDS), (1,))
