"""The rounds of a coherent estimate: which camera pixels are solved, and where they seek light.

In a small frame every camera pixel first searches all projector pixels, which costs the product of
both. In others only seeds search: every second camera pixel along both axes, in large frames every
fourth to 64th. Their estimates spread to all others, as matches do in PatchMatch stereo (Barnes et
al. 2009); camera pixels whose samples this does not explain then search for themselves.
"""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Growth:
    """How estimates spread from seeds.

    With `settling` 4, a procedural capture of 512 x 512 took a third more time, and its error was
    0.05946 in place of 0.0595. Values without a measurement beside them are chosen by hand.
    """

    # A frame is small if camera samples times projector pixels do not exceed this: 91 x 91 of both.
    small: int = 1 << 26
    # A frame is large if they exceed this. 128 x 128 pixels of both, in colour too, stay below.
    large: int = 1 << 30
    # The spacing of the seeds in frames between small and large ones, and their rounds after the
    # search; the others are rounds of all camera pixels. At 128 x 128 metal errs by 1 % more than
    # after a search by all, and by 3 % more with seeds every 4 pixels (docs/measurements.md).
    near_seeds: int = 2
    near_seed_rounds: int = 2
    # They need this many camera pixels for each projector pixel. Where cameras are coarser, seeds
    # hardly help each other: metal at 256 x 256 under a camera of 64 x 64 errs by 3 % more.
    near_density: float = 0.5
    # Spacings of the solved camera pixels, level by level. The first sequence applies for which the
    # camera has enough seeds. A spacing is at most four times the next one, since rows reach only
    # `reach` pixels to both sides and would leave gaps.
    spacings: tuple[tuple[int, ...], ...] = (
        (64, 16, 4, 1),
        (32, 8, 4, 1),
        (16, 4, 1),
        (8, 4, 1),
        (4, 1),
    )
    # The half width in camera pixels that the first window must have.
    reach: int = 2
    # Seeds along the shorter side of the camera that a sequence needs; the last one needs half as
    # many. With 16, metal at 256 x 256 (64 patterns) errs by 0.0248 in place of 0.0207.
    fewest_seeds: int = 30
    # Rounds at each finer level after the one in which estimates spread to it.
    settling: int = 2
    # Rounds at a level after which its unexplained rows search all projector pixels, but one at the
    # last level of large frames.
    search_after: int = 2
    # A row is unexplained if its objective exceeds this share of what an even background leaves of
    # its samples. Measured on procedural scenes: the share is at most 0.02 in rows that are right,
    # and at least 0.4 in rows that are wrong. One-pixel slivers of metal lie between, as neighbours
    # explain them halfway: a tenth in place of a quarter takes the error of metal at 256 x 256 from
    # 0.0221 to 0.0207. Large frames have the higher share, since their searches take long.
    unexplained: float = 0.1
    unexplained_near: float = 0.05


GROWTH = Growth()
# The number of rounds after which rows get pseudo-samples. Chosen by hand: most rows are about
# right by then, so that their neighbours can rely on them.
PSEUDO_SAMPLES_FROM = 3

# The atoms of a projector of more pixels take more than 2.5 GB, so that they are not kept: those
# that some rows may see are made, on a sheet, when these rows are solved.
KEPT_PIXELS = 1 << 20

# Half widths of a window in camera and in projector pixels.
Window = tuple[int, int]


@dataclass(frozen=True)
class Round:
    """One pass over every `spacing`-th camera pixel along both axes."""

    spacing: int
    # Half widths in camera and projector pixels; None searches all projector pixels by row.
    window: Window | None
    # Rounds that the rows, or those that they spread from, have behind them.
    age: int
    last: bool = False
    # Rows of which more than this share is unexplained search all projector pixels; 0: none does.
    search_unexplained: float = 0.0
    # Rows stay as they are if nothing changed around them.
    skip_settled: bool = False
    # Only every second row is solved, as the black squares of a chessboard.
    skip_every_second: bool = False
    # Neighbours' rows stand in for samples that clip or were never taken.
    has_pseudo_samples: bool = False


def schedule(
    camera: tuple[int, ...], pixels: int, windows: tuple[Window, ...]
) -> tuple[Round, ...]:
    """All rounds in turn; `windows` are those of a small frame after the search."""
    steps = spacings(camera, pixels, windows)
    # The windows of the rounds of each spacing; those of the seeds come after the search.
    by_level, cut = [windows], GROWTH.near_seed_rounds
    if len(steps) > 1 and steps[0] == GROWTH.near_seeds:
        by_level = [windows[:cut], windows[cut:]]
    elif len(steps) > 1:
        between = (windows[0], *windows[-GROWTH.settling - 1 : -1])
        # Where atoms are not kept, solving every second row takes as long as solving all of them,
        # since the same atoms are made. So the round between is left out.
        settling = GROWTH.settling if pixels <= KEPT_PIXELS else 1
        final = (windows[0], *windows[-settling:])
        by_level = [windows[:-1], *([between] * (len(steps) - 2)), final]
    (first, seed_windows), *finer = zip(steps, by_level, strict=True)
    near = first <= GROWTH.near_seeds
    share = GROWTH.unexplained_near if near else GROWTH.unexplained
    rounds = [Round(first, None, 0)]
    for age, window in enumerate(seed_windows, start=1):
        known = first == 1 and age >= PSEUDO_SAMPLES_FROM
        rounds.append(Round(first, window, age, has_pseudo_samples=known))
    for spacing, own in finer:
        # In large frames all rows are solved twice, and every second one once more in between. A
        # third time would change errors by less than 1 %, and take a sixth of the time.
        twice = spacing == 1 and not near
        searched = min(1 if twice else GROWTH.search_after, len(own) - 1)
        for i, window in enumerate(own):
            searching = share if i + 1 == searched else 0.0
            settled = not twice and i >= searched and window == own[i - 1]
            # Between distant camera pixels, and where estimates have just spread from them,
            # pseudo-samples change errors by 0.03 %, and take half of the time.
            known = spacing == 1 and (near or i > 0)
            skips, age = (settled, twice and i > 0), rounds[-1].age + 1
            rounds.append(Round(spacing, window, age, False, searching, *skips, known))
    last = replace(rounds.pop(), last=True, skip_settled=False, skip_every_second=False)
    return (*rounds, replace(last, search_unexplained=0.0))


def is_large(samples: int, pixels: int) -> bool:
    """Whether a frame is so large that only few of its camera samples can search."""
    return samples * pixels > GROWTH.large


def spacings(camera: tuple[int, ...], pixels: int, windows: tuple[Window, ...]) -> tuple[int, ...]:
    """The spacings from the seeds to all camera pixels; (1,) of a small frame."""
    rows, cols, *channels = camera
    samples = rows * cols * (channels[0] if channels else 1)
    large = is_large(samples, pixels)
    small = not large and samples * pixels <= GROWTH.small
    if small or windows[0][0] < GROWTH.reach:
        return (1,)
    possible = GROWTH.spacings if large else ((GROWTH.near_seeds, 1),)
    # Seeds need rounds after their search: some of their own, and two of all pixels.
    too_few = len(windows) < GROWTH.near_seed_rounds + 2
    if not large and (too_few or rows * cols < GROWTH.near_density * pixels):
        return (1,)
    for steps in possible:
        fewest = GROWTH.fewest_seeds // (2 if steps is possible[-1] else 1)
        if min(rows, cols) // steps[0] >= fewest:
            return steps
    return (1,)
