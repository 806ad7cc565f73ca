"""Whether each frame of a code of stripes shows its pattern: not white or black, nor dimmed.

The frames of a code tell a place, an amount of light and a constant for each camera pixel, which
are fewer numbers than there are frames. What they leave unexplained shows which frame is brighter
or darker than the others, and whether grey values come as they are.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lightmatrix.check.code_order import CERTAIN, CodeLattice, Name
from lightmatrix.check.finding import STEADY_LIGHT, Finding, odd_light
from lightmatrix.patterns.codes import Code

# A frame has another light if half of the camera pixels see it differ by as much, and three
# quarters by half of it. Chosen by hand: through dusty glass, where some pixels see two surfaces,
# half of them differ by 0.2 in intact captures, but three quarters by 0.02 only; elsewhere half
# differ by 0.06.
_OTHER_LIGHT = 0.12
# Grey values do not come as they are if their skewness differs by as much in three quarters of the
# camera pixels. Chosen by hand: in intact captures it differs by less than 0.02, and by 0.04 under
# a gamma of 1.2.
_SKEWED = 0.03
# Fewer camera pixels tell no fault from chance; a lattice has as many at least.
_FEWEST = 40
_Array = NDArray[np.float64]


def check_uniform(lattice: CodeLattice, name: Name) -> list[Finding]:
    """Whether a frame of a code is white or black although its pattern is not.

    Nearly all pixels are then as bright, or as dark, as they ever are. Without a coarse bit, half
    of the places are mirrored; without a fine one, neighbours see nearer to each other than without
    another. A camera that sees only the white part of a pattern shows bright pixels alone.
    """
    codes = lattice.codes.codes
    used = np.unique(np.concatenate([each.frames[np.ptp(each.values, 0) > 0] for each in codes]))
    low, high = np.quantile(lattice.shares[used], [0.1, 0.9], axis=1)
    plain = used[(low > 0.8) | (high < 0.2)]
    if not len(plain):
        return []
    frames = np.arange(lattice.patterns.count)
    wrong = [k for code in codes for k in _folding(lattice, code, plain)]
    if not wrong:
        own = lattice.costs(frames, {})
        gains = [own - lattice.costs(np.where(frames == k, -1, frames), {}) for k in used]
        total = np.sum(gains, axis=1)
        best = int(np.where(np.isin(used, plain), total, -np.inf).argmax())
        certain = CERTAIN * float(np.sqrt((gains[best] ** 2).sum()))
        if total[best] > max(certain, 1.5 * float(np.median(total))):
            wrong = [int(used[best])]
    advice = "take the photograph again, unless part of the scene is seen in a mirror"
    shown = ["white" if lattice.shares[k].mean() > 0.5 else "black" for k in wrong]
    return [
        Finding("frame", (k,), f"{name(k)}: {grey}, although the pattern is not", advice)
        for k, grey in zip(wrong, shown, strict=True)
    ]


def _folding(lattice: CodeLattice, code: Code, plain: NDArray[np.int64]) -> list[int]:
    """The frame among plain ones that mirrors part of the places; empty if none are mirrored."""
    frames = np.arange(lattice.patterns.count)
    line = lattice.lines(code, frames)[0][0].reshape(3, -1)
    steps = np.where((line >= 0).all(axis=0), line[1:] - line[0], 0)
    turns = np.sign(steps[np.abs(steps).sum(axis=1).argmax()])
    # Edges, noise and reflections mirror at most a tenth of the places of a whole capture.
    if min((turns > 0).sum(), (turns < 0).sum()) < max(0.15 * np.abs(turns).sum(), _FEWEST):
        return []
    far = lattice.pairs[:, lattice.neighbours :]

    def apart(lines: NDArray[np.int64]) -> float:
        one, other = lines.ravel()[far]
        # Words that do not occur are no likely places.
        steps = np.where((one < 0) | (other < 0), 8, np.abs(one - other))
        return float(np.minimum(steps, 8).mean())

    unfolded = {}
    for k in np.intersect1d(plain, code.frames):
        # Its bit the other way round: dark comes first, and last, bright.
        unread = lattice.lines(code, np.where(frames == k, -1, frames))[0]
        turned = unread[0 if lattice.shares[k].mean() > 0.5 else -1].reshape(3, -1)
        # Either way round may be the right one.
        unfolded[int(k)] = min(apart(np.where(turns == t, turned, line)) for t in (1, -1))
    # Unfolded by the frame that is wrong, bits place neighbours at most 2.2 times as far apart. In
    # healthy captures, where noise or a rough surface turns single pixels, it is 2.9 to 6.6 times.
    # For phases the factors are at most 0.94, and 0.98 and more.
    most = (2.5 if code.bits else 0.97) * apart(line)
    return [k for k in unfolded if unfolded[k] == min(unfolded.values()) < most]


def check_brightness(lattice: CodeLattice, name: Name) -> list[Finding]:
    """Whether each frame is as bright as the others tell, where its pattern is."""
    count = lattice.patterns.count
    # The quartiles of how bright frames are, and how often their stripes change.
    light, changes = np.full((3, count), np.nan), np.zeros(count)
    for code, samples, values, predicted in _fits(lattice):
        lit = values > 0.5 * values.max(axis=1, keepdims=True)
        enough = lit.sum(axis=0) >= _FEWEST
        ratio = np.divide(samples, predicted, out=np.full(lit.shape, np.nan), where=lit)[:, enough]
        light[:, code.frames[enough]] = np.nanquantile(ratio, [0.25, 0.5, 0.75], axis=0)
        changes[code.frames] = code.changes
    (low, middle, high), odd = light, dict[int, float]()
    known = np.isfinite(middle)
    for k in np.flatnonzero(known):
        # Stripes light less of a pixel's surroundings the finer they are, so that a frame is as
        # bright as coarser ones, finer ones, or in between.
        parts = (known, known & (changes <= changes[k]), known & (changes >= changes[k]))
        usual = [float(np.median(middle[part])) for part in parts]
        least, most = min(usual), max(usual)
        change = middle[k] / np.clip(middle[k], least, most) - 1
        darker = high[k] < (1 - _OTHER_LIGHT / 2) * least
        brighter = low[k] > (1 + _OTHER_LIGHT / 2) * most
        if abs(change) > _OTHER_LIGHT and (darker or brighter):
            odd[int(k)] = float(change)
    if not odd:
        return []
    message = odd_light({name(k): change for k, change in odd.items()})
    return [Finding("gain", tuple(odd), message, STEADY_LIGHT)]


def check_grey_values(lattice: CodeLattice) -> list[Finding]:
    """Whether light is proportional to the grey values of patterns: both are skewed alike."""
    for code, samples, values, _ in _fits(lattice):
        if code.bits:
            continue
        low, high = np.quantile(_skewness(samples) - _skewness(values), [0.25, 0.75])
        if low < _SKEWED and high > -_SKEWED:
            continue
        message = (
            f"greys of the patterns are too {'dark' if low > 0 else 'bright'} in the photographs, "
            "compared with black and white: a curve of the camera or of the projector"
        )
        advice = (
            "take raw files, or state the camera's response (srgb for most JPEG files); make the "
            "projector linear, or project Gray code, which has no greys"
        )
        return [Finding("projector-curve" if low > 0 else "camera-curve", (), message, advice)]
    return []


def _fits(lattice: CodeLattice) -> Iterator[tuple[Code, _Array, _Array, _Array]]:
    """Each code with the samples of some pixels, the values of their lines, and the best fit."""
    for code in lattice.codes.codes:
        line = lattice.lines(code, np.arange(lattice.patterns.count))[0][0]
        samples = lattice.samples[code.frames].T.astype(float)
        # Dim samples are mostly noise, and the brightest ones may clip.
        spread = samples.std(axis=1)
        lit = (line >= 0) & (spread > 0.3 * np.quantile(spread, 0.9))
        used = lit & (samples.max(axis=1) < 0.99 * lattice.samples.max())
        if used.sum() < max(_FEWEST, 0.5 * lit.sum()):
            continue
        samples, values = samples[used], code.values[line[used]].astype(float)
        mean = samples.mean(axis=1, keepdims=True)
        shown = values - values.mean(axis=1, keepdims=True)
        light = ((samples - mean) * shown).sum(axis=1) / (shown**2).sum(axis=1)
        yield code, samples, values, mean + light[:, None] * shown


def _skewness(values: _Array) -> _Array:
    """The skewness of each row."""
    apart = values - values.mean(axis=1, keepdims=True)
    return np.asarray((apart**3).mean(axis=1) / (apart**2).mean(axis=1) ** 1.5)
