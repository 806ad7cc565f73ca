"""What changes from frame to frame: the light, pictures that come late, the place of the camera."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.check.finding import STEADY_LIGHT, odd_light
from lightmatrix.check.prediction import best_pixels, column_scale
from lightmatrix.rig_model.prediction import Prediction, samples_of_rows, slopes
from lightmatrix.rig_model.term import Array, Draft, Term, deviation

# Light: lamps, room, mains, irises.


class Gain(Term):
    """Frame k has (1 + g_k) times the light."""

    name = "gain"
    advice = STEADY_LIGHT
    per_frame = True

    def regressors(self, seen: Prediction) -> Array:
        return seen.predicted[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.gain = draft.gain * (1 + values[0])

    def added(self, values: Array, step: Array) -> Array:
        return (1 + values) * (1 + step) - 1

    def based(self, values: Array) -> Array:
        # A first frame that is odd is no measure, as of a lamp or shutter that had just started.
        usual = np.median(values) if 0 in _odd(values[0]) else values[0, 0]
        return np.asarray((1 + values) / (1 + usual) - 1)

    def label_of(self, values: Array) -> str:
        return "gain" if _step(values[0]) is None else "exposure"

    def sentence(self, values: Array) -> str:
        k = _step(values[0])
        if k is None:
            if len(odd := _odd(values[0])):
                return odd_light({f"frame {j}": values[0, j] - np.median(values) for j in odd})
            return f"the light varied by {100 * deviation(values):.1f} % from frame to frame"
        change = (1 + values[0, k:].mean()) / (1 + values[0, :k].mean()) - 1
        return f"the exposure changed by {100 * change:+.1f} % before frame {k}"


def _odd(gain: Array) -> NDArray[np.int64]:
    """Up to three frames whose light is not that of the others."""
    usual = gain - np.median(gain)
    odd = np.flatnonzero(np.abs(usual) > max(0.02, 6 * np.median(np.abs(usual))))
    return odd if len(odd) <= 3 else odd[:0]


def _step(gain: Array) -> int | None:
    """The frame before which the light changed once, if that leaves a tenth of its variance."""
    if len(_odd(gain)):
        return None
    cuts = range(1, len(gain))
    left = [gain[:k].var() * k + gain[k:].var() * (len(gain) - k) for k in cuts]
    best = int(np.argmin(left))
    return best + 1 if left[best] < 0.1 * gain.var() * len(gain) else None


class Ambient(Term):
    """All samples of frame k have a_k more light."""

    name = "ambient"
    advice = "shut out other light, and switch off what lights up by itself"
    per_frame = True

    def regressors(self, seen: Prediction) -> Array:
        return np.ones((1, *seen.predicted.shape))

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.ambient = draft.ambient + values[0]

    def sentence(self, values: Array) -> str:
        return f"the room's light varied by {100 * deviation(values):.1f} % of the clip level"


class DynamicContrast(Term):
    """The light is 1 + a times the pattern's mean, less that of the first pattern."""

    name = "dynamic-contrast"
    advice = "switch dynamic contrast, eco mode and iris off"
    between = (-1, 1)

    def regressors(self, seen: Prediction) -> Array | None:
        means = seen.sent.patterns.means
        # Patterns that are about as bright as each other tell nothing.
        return None if float(np.std(means)) < 0.02 else ((means - means[0]) * seen.predicted)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        means = draft.capture.patterns.means
        draft.gain = draft.gain * (1 + values[0] * (means - means[0]))

    def sentence(self, values: Array) -> str:
        change = f"{100 * values[0]:+.0f} % from black to white"
        return f"the projector's light follows its picture: {change}"


def _waves(height: Array) -> Array:
    """A constant, and half a period to three over the picture's height, of places from 0 to 1."""
    return np.stack([np.cos(np.pi * number * height) for number in range(7)])


class Rows(Term):
    """The light of frame k varies over the camera's rows, as a sum of cosines."""

    name = "rows"
    advice = (
        "expose for whole periods of the mains and of the projector (1/50 or 1/60 s and "
        "multiples), or use a global shutter"
    )
    per_frame = True
    # The phase differs from frame to frame, so the mean of all frames is nearer to an even light
    # than the first frame.
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return _waves(seen.position[0]) * seen.predicted

    def take_out(self, values: Array, draft: Draft) -> None:
        rows = draft.capture.camera_shape[0]
        draft.profile = 1 + np.tensordot(_waves((np.arange(rows) + 0.5) / rows), values, (0, 0))

    def sentence(self, values: Array) -> str:
        waves = _waves((np.arange(100) + 0.5) / 100)
        amplitude = 100 * np.sqrt(2) * np.std(np.tensordot(waves, values, (0, 0)))
        return f"the light varied by {amplitude:.1f} % along the camera's rows (rolling shutter?)"


# Light of another picture: a slow panel, the lag of a camera, a late refresh.


class Previous(Term):
    """Each photograph holds a share a of the pattern before its own."""

    name = "previous"
    advice = "wait longer after each change of pattern (`lightmatrix rig settle` measures how long)"
    between = (0, 1)

    def regressors(self, seen: Prediction) -> Array:
        return seen.under(lambda images, before: before - images)[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        share = float(values[0])
        draft.patterns.append(lambda images, before: (1 - share) * images + share * before)

    def added(self, values: Array, step: Array) -> Array:
        # T has taken on the light of the pattern itself, 1 - a of what it should be.
        return values + step / (1 + step)

    def sentence(self, values: Array) -> str:
        return f"each photograph shows {100 * values[0]:.1f} % of the picture before it"


# The picture is looked at in up to this many bands of rows, of each 32 of its camera pixels.
_BANDS, _PIXELS = 64, 32


class Torn(Term):
    """Each camera row shows the pattern of this many frames before: -1, 0 or 1, (1, rows)."""

    name = "torn"
    label = "previous"
    advice = Previous.advice

    def found(self, seen: Prediction) -> Array | None:
        """A band of rows is late if nearly half of its pixels follow a projector pixel better then.

        Half of all bands are in order. T is not asked, since it is wrong.
        """
        capture = seen.capture
        rows, cols = capture.camera_shape[0], int(np.prod(capture.camera_shape[1:]))
        if capture.count < 12:
            return None
        bands = np.array_split(np.arange(rows), min(rows, _BANDS))
        draw = np.random.default_rng(0)
        chosen = np.stack(
            [draw.choice(band, _PIXELS) * cols + draw.integers(0, cols, _PIXELS) for band in bands]
        )
        samples = samples_of_rows(capture, chosen.ravel())
        each = np.zeros((3, len(bands) * _PIXELS))
        each[1] = _followed(capture, samples.values, 0)
        # A sample that follows the frame's own pattern this well follows no other better by 0.1.
        some = each[1] < 0.9
        for lag in (-1, 1) if some.any() else ():
            each[1 + lag, some] = _followed(capture, samples.values[some], lag)
        follow = each.reshape(3, len(bands), _PIXELS)
        # Dark pixels follow nothing, and tell nothing.
        lit = follow.max(axis=0) > 0.8
        better = (follow - follow[1] > 0.1) & lit
        share = better.sum(axis=2) / np.maximum(lit.sum(axis=1), 1)
        # The share reached 0.3 by chance in bundled scenes under 16 and 32 patterns, and was 0.53
        # or more in late bands.
        late = np.where(lit.sum(axis=1) >= _PIXELS // 4, share, 0) > 0.45
        found = np.where(late[2], 1.0, np.where(late[0], -1.0, 0.0))
        if not found.any() or np.mean(found != 0) > 0.5:
            return None
        # A band of dark pixels between late ones is late, too.
        known = np.flatnonzero((lit.sum(axis=1) >= _PIXELS // 4) | (found != 0))
        nearest = known[np.abs(np.arange(len(bands))[:, None] - known).argmin(axis=1)]
        return np.repeat(found[nearest], [len(band) for band in bands])[None]

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.lag = np.rint(values[0]).astype(np.int64)

    def sentence(self, values: Array) -> str:
        share = 100 * np.mean(values[0] != 0)
        return f"{share:.0f} % of the camera's rows show the pattern of another frame"


def _followed(capture: Capture, values: Array, late: int) -> Array:
    """The correlation of samples (m, K), read `late` frames later, with their best pixel, (m,)."""
    count = capture.count
    patterns = np.arange(max(0, -late), count - max(0, late))
    shown = capture.patterns.subset(patterns)
    read = _scaled(values[:, patterns + late])
    pixels = best_pixels(shown, column_scale(shown), read)
    return np.asarray((_scaled(shown.columns(pixels).T.astype(np.float64)) * read).sum(axis=1))


def _scaled(values: Array) -> Array:
    values = values - values.mean(axis=1, keepdims=True)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


# A picture that moves, grows or turns: soft stands, lenses that breathe.


class Shift(Term):
    """The image of frame k lies d_k camera pixels (down, right) from where it was."""

    name = "shift"
    advice = "use a stiff stand, and let everything warm up"
    per_frame = True
    # T is that of the mean place, which is known best.
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return -seen.slopes

    def take_out(self, values: Array, draft: Draft) -> None:
        draft.shift = values

    def added(self, values: Array, step: Array) -> Array:
        # T is blurred by what it swallowed, so that steps are too short, by shares that are alike.
        along = float((step * values).sum() / max((values**2).sum(), 1e-12))
        return values + step / (1 - min(max(along, 0.0), 0.6))

    def sentence(self, values: Array) -> str:
        # A creep is smooth: frames differ less from the next one than from all others.
        steps = np.diff(values, axis=1)
        if (steps**2).sum() < 0.4 * ((values - values.mean(axis=1)[:, None]) ** 2).sum():
            moved = float(np.hypot(*(values[:, -1] - values[:, 0])))
            return f"the picture crept by {moved:.2f} camera pixels in the course of the capture"
        return f"the picture shook by {deviation(values):.2f} camera pixels from frame to frame"


def _directions(position: Array) -> Array:
    """Where places (2, ...) move by a pixel at the border: (zoom and turn, down and right, ...)."""
    down, right = 2 * position - 1
    return np.stack([np.stack([down, right]), np.stack([-right, down])])


class Zoom(Term):
    """Frame k is larger by z_k pixels at the border of the picture, and turned by t_k."""

    name = "zoom"
    label = "shift"
    advice = "switch autofocus and stabilization off, and tape the rings of the lens"
    per_frame = True
    of_first_frame = False

    def regressors(self, seen: Prediction) -> Array:
        return -(_directions(seen.position) * seen.slopes).sum(axis=1)

    def take_out(self, values: Array, draft: Draft) -> None:
        def moved(images: Array, places: Array, sign: int) -> Array:
            directions = _directions(places)[..., None, None]
            change = 0.0
            for axis, (slope, bend) in enumerate(zip(*slopes(images), strict=True)):
                step = (directions[:, axis] * sign * values[:, None, None, None, :]).sum(axis=0)
                change = change + step**2 / 2 * bend - step * slope
            return np.asarray(change)

        draft.images.append(partial(moved, sign=1))
        draft.back.append(partial(moved, sign=-1))

    def sentence(self, values: Array) -> str:
        return f"the picture grew or turned by {deviation(values):.2f} camera pixels at its border"
