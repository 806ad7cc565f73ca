"""The pattern under which the camera sees a picture, a video, or direct light only.

`compensate`, `compensate_video` and `cancel_global` share one bounded least squares problem.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property, partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix import _core
from lightmatrix.errors import InputError
from lightmatrix.files.colours import COLOURS, holds_colour, shown_files, stores_within
from lightmatrix.files.extras import video_frames
from lightmatrix.files.images import DISPLAY_GAMMA, write_image
from lightmatrix.files.kinds import IMAGE, PATTERNS
from lightmatrix.files.stacks import list_images
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.folder import write_patterns
from lightmatrix.patterns.pattern_set import ImagePatterns, grid_cells
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_list, check_number
from lightmatrix.reprs import ShortRepr
from lightmatrix.resources.threads import work_ahead
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.loading import Transport, loaded
from lightmatrix.uses.separation import pattern_or_white, separate
from lightmatrix.uses.wanted import WantedPicture, ambient_samples, mask_samples, wanted_samples

Singles = NDArray[np.float32]

# Iterations of the solver. Against 300, 25 lose at most 0.2 dB on the bundled scenes at 64 x 64.
USUAL_ITERATIONS = 25

# Frames of a video that are solved together, as many as the core multiplies at once, and their
# steps; three times as many where no frame is before them. In a picture that pans they lose 0.9 dB
# against hundreds of iterations, three steps 1.3, five 0.7 (benchmarks/video.py).
_TOGETHER, _FRAME_STEPS = 16, 4

# Samples are reached that differ from the wanted light by at most this share of wanted white, about
# 13 levels of an 8-bit picture.
_CLOSE = 0.05

# The light of one or several projectors in one camera, c = T1 p1 + T2 p2 + ...: one operator.


@dataclass(frozen=True, eq=False)
class JointLight:
    """[T1 T2 ...] in single precision; patterns of all projectors are one vector, (N,)."""

    # One projector each, or one primary of a colour projector.
    matrices: tuple[LightTransport, ...]
    # (N,): 1 for projector pixels that may give light, 0 for those that stay black; None: all may.
    usable: Singles | None = None
    # Whether they are red, green and blue of one projector.
    in_colour: bool = False

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels)."""
        return self.matrices[0].camera_shape

    def check_single(self) -> None:
        """Raise an InputError if there is more than one projector or primary."""
        if len(self.matrices) > 1:
            hint = "single pictures are compensated with several projectors, or in colour"
            raise InputError(f"{len(self.matrices)} matrices, for a use that takes one", hint=hint)

    def split(self, light: Singles) -> tuple[Singles, ...]:
        """The patterns, (rows, cols) each, of a vector (N,)."""
        ends = np.cumsum([matrix.shape[1] for matrix in self.matrices])
        parts = np.split(light, ends[:-1])
        return tuple(
            part.reshape(matrix.projector_shape)
            for part, matrix in zip(parts, self.matrices, strict=True)
        )

    def forward(self, light: Singles) -> Singles:
        """T p: camera samples (M,) of patterns (N,)."""
        result = np.zeros(self.matrices[0].shape[0], np.float32)
        for pattern, matrix in zip(map(np.ravel, self.split(light)), self.matrices, strict=True):
            result += matrix.sparse @ pattern
            result += matrix.background @ (matrix.pooling @ pattern)
        return result

    def adjoint(self, samples: Singles) -> Singles:
        """T' c: projector pixels (N,) of camera samples (M,)."""
        parts = [
            matrix.sparse.T @ samples + matrix.pooling.T @ (matrix.background.T @ samples)
            for matrix in self.matrices
        ]
        return np.concatenate(parts)

    @cached_property
    def white(self) -> Singles:
        """The light of each camera sample under white of all projectors, (M,)."""
        return np.asarray(sum(self._whites))

    @cached_property
    def errors(self) -> Singles:
        """Estimated relative error of what each camera sample sees under white, (M,).

        The errors of several matrices are independent. 0 where an estimate does not state one.
        """
        squares = np.zeros_like(self.white)
        for matrix, white in zip(self.matrices, self._whites, strict=True):
            stated = matrix.diagnostics.get("estimated_error")
            if stated is not None:
                squares += (np.nan_to_num(stated, nan=0.0).astype(np.float32) * white) ** 2
        relative = np.zeros_like(squares)
        return np.divide(np.sqrt(squares), self.white, out=relative, where=self.white > 0)

    @cached_property
    def _whites(self) -> list[Singles]:
        """The light of each camera sample under white of each projector, of its usable pixels."""
        usable = self.usable
        if usable is None:
            usable = np.ones(sum(matrix.shape[1] for matrix in self.matrices), np.float32)
        patterns = zip(self.matrices, self.split(usable), strict=True)
        return [matrix @ pattern.ravel() for matrix, pattern in patterns]


def joint_light(transport: Transport | Sequence[Transport]) -> JointLight:
    """The operator of one matrix, or of several of one camera, loaded if they are on disk.

    The folder of a colour projector stands for the matrices of its primaries, that of several
    projectors for theirs, and a T of several that were measured at once for its parts.
    An InputError says that they do not fit into memory, or that their cameras differ.
    """
    several = isinstance(transport, Sequence) and not isinstance(transport, str)
    sources: list[Any] = [*transport] if several else [transport]  # type: ignore[misc]
    if not sources:
        raise InputError("no light transport matrix", hint="give one, or one for each projector")
    parts: list[Any] = []
    for source in sources:
        parts += (isinstance(source, str | Path) and stores_within(source)) or (source,)
    # A compensation of a megapixel camera with 29 entries a row and 64 values of background took
    # 1.5 times the memory of its matrix (python -m benchmarks.uses_at_scale).
    matrices = tuple(one for part in parts for one in loaded(part, 1.5).split())
    shapes = sorted({matrix.camera_shape for matrix in matrices})
    if len(shapes) > 1:
        raise InputError(
            f"matrices of cameras of shapes {' and '.join(map(str, shapes))}",
            hint="give matrices that one camera measured, with the same binning",
        )
    primaries = [matrix.provenance.get("primary") for matrix in matrices]
    of_one = len(sources) == 1 and isinstance(sources[0], str | Path) and holds_colour(sources[0])
    return JointLight(matrices, in_colour=of_one or primaries == list(COLOURS))


# The images of the patterns.


def write_shown(output: str | Path, found: "Compensation", *, overwrite: bool = False) -> None:
    """Write its patterns as images: one, which may be in colour, or several with numbers."""
    images = [np.stack(found.encoded, axis=-1)] if found.in_colour else found.encoded
    files = shown_files(output, len(images))
    for place in files:
        check_output(place, IMAGE, overwrite=overwrite)
    for place, image in zip(files, images, strict=True):
        write_image(place, image, overwrite=overwrite)


# What is assumed of projectors of which nothing is known: nearly all follow pictures for displays.
ASSUMED = ProjectorResponse.of_gamma(DISPLAY_GAMMA)


def encoding_of(
    given: ProjectorResponse | str | Path | None, light: JointLight
) -> tuple[ProjectorResponse | None, ...]:
    """What each projector's patterns are encoded by: what is given, or what the patterns of T were.

    None is light, as of a response that is linear.
    """
    if given is None:
        found = (ProjectorResponse.of_provenance(one.provenance) for one in light.matrices)
        return tuple(curve or ASSUMED for curve in found)
    curve = given if isinstance(given, ProjectorResponse) else ProjectorResponse.parse(given)
    return (None if given == "linear" else curve,) * len(light.matrices)


def described(encoding: Sequence[ProjectorResponse | None]) -> dict[str, Any]:
    """The gamma of what patterns are encoded by, None for light, and whether it is assumed."""
    gamma = next((curve.gamma for curve in encoding if curve), None)
    return {"projector_gamma": gamma, "projector_gamma_assumed": ASSUMED in encoding}


# Least squares over patterns in [0, 1], and what it reaches.


@dataclass(frozen=True, eq=False)
class BoundedFit:
    """min over p in [0, 1] of f(p) = 1/2 ||T p - y||^2_W + r/2 ||p||^2.

    FISTA (Beck & Teboulle 2009) in the metric of L = T' W T 1 + r, with the restart by gradient of
    O'Donoghue & Candes (2015). As T has no negative entries, diag(L) - T' W T is diagonally
    dominant, hence positive semidefinite: 1 / L is a safe step for each pixel by itself. Of a T
    with negative entries, L takes the magnitudes.
    """

    light: JointLight
    # (M,) float32: weights W >= 0 of the camera samples.
    weights: Singles

    @cached_property
    def _bounds(self) -> Singles:
        """T' W T 1, (N,), of the magnitudes of T, which may have been estimated signed."""
        light, several = self.light, self.light.matrices
        if any((m.sparse.data < 0).any() or (m.background < 0).any() for m in several):
            sizes = ((abs(m.sparse), abs(m.background)) for m in several)
            pairs = zip(several, sizes, strict=True)
            several = tuple(replace(m, sparse=s, background=b) for m, (s, b) in pairs)
            light = replace(light, matrices=several)
        return light.adjoint(self.weights * light.white)

    @cached_property
    def ridge(self) -> float:
        """The ridge r; positive, so that the solution is unique."""
        seen = self._bounds[self._bounds > 0]
        # It darkens pixels that no camera pixel sees, and costs no PSNR on the bundled scenes;
        # 1e-2 costs up to 0.8 dB.
        return 1e-3 * float(np.median(seen)) if seen.size else 1.0

    def gradient(self, light: Singles, samples: Singles) -> Singles:
        """The gradient of f, (N,), at patterns (N,) for the wanted samples y (M,)."""
        misfit = self.light.forward(light)
        misfit -= samples
        misfit *= self.weights
        gradient = self.light.adjoint(misfit)
        gradient += np.float32(self.ridge) * light
        return gradient

    def solve(self, samples: Singles, start: Singles, iterations: int) -> Singles:
        """The patterns (N,) float32 in [0, 1] after so many iterations from the start (N,)."""
        bounds = self._bounds + np.float32(self.ridge)
        most = 1 if self.light.usable is None else self.light.usable
        pattern = np.clip(start, 0, most).astype(np.float32)
        ahead, momentum = pattern, 1.0
        for _ in range(iterations):
            # A projected gradient step from the point ahead.
            updated = ahead - self.gradient(ahead, samples) / bounds
            np.clip(updated, 0, most, out=updated)
            step = updated - pattern
            # Restart once the step goes against the gradient.
            if float(np.vdot((ahead - updated) * bounds, step)) > 0:
                momentum = 1.0
            grown = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = updated + np.float32((momentum - 1) / grown) * step
            pattern, momentum = updated, grown
        return pattern


class Reach(IntEnum):
    """What becomes of a camera sample, the values of `Compensation.reach`."""

    REACHED = 0
    # The mask leaves it out.
    MASKED = 1
    # The projector hardly lights it.
    SHADOW = 2
    # It asks for more light than it gets.
    TOO_DARK = 3
    # It gets more than it asks for: light of other surfaces, or of the room.
    TOO_BRIGHT = 4


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(ShortRepr):
    """The pattern for a wanted picture, and what the camera will see; made by `compensate`.

    Parameters
    ----------
    patterns : tuple of (rows, cols) float32
        The pattern of each projector, or of each primary, in [0, 1].
    predicted : camera_shape float32
        The photograph to expect, c = T p + ambient, at exposure 1, not clipped.
    target : camera_shape float32
        The light that was asked for, s d.
    scale : float
        s: the light of wanted white, in units of camera full scale. With a colour camera the mean
        over its channels, which share it as they do the projector's white.
    brightness : float
        `scale` as a share of what the lit camera samples see under a white pattern, their median.
    reach : camera_shape uint8
        0 where the picture is reached; else why not (see `Reach`): 1 masked, 2 in shadow, 3 too
        dark there, 4 too bright there.
    encoding : tuple of ProjectorResponse or None
        What `encoded` and the written image encode each pattern by; None: as light.
    uncompensated_psnr : float, optional
        What `psnr` would be, at its best brightness, if the picture were shown as it is.
    in_colour : bool
        Whether the patterns are red, green and blue of one projector, which make one image.
    """

    patterns: tuple[Singles, ...]
    predicted: Singles
    target: Singles
    scale: float
    brightness: float
    reach: NDArray[np.uint8]
    encoding: tuple[ProjectorResponse | None, ...] = ()
    uncompensated_psnr: float | None = None
    in_colour: bool = False

    @property
    def encoded(self) -> tuple[Singles, ...]:
        """The patterns as grey values in [0, 1], by which the projectors show their light."""
        encoding = self.encoding or (None,) * len(self.patterns)
        return tuple(
            pattern if response is None else response.encoded(pattern)
            for pattern, response in zip(self.patterns, encoding, strict=True)
        )

    @property
    def pattern(self) -> Singles:
        """The pattern (rows, cols) of one projector; of several of one size (rows, cols, count)."""
        if len(self.patterns) == 1:
            return self.patterns[0]
        if len({pattern.shape for pattern in self.patterns}) > 1:
            raise InputError("the projectors differ in size", hint="take them from `patterns`")
        return np.stack(self.patterns, axis=-1)

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Camera samples that come within 5 % of wanted white of what they should be."""
        return self.reach == Reach.REACHED

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """Camera samples that would clip at exposure 1."""
        return self.predicted >= 1

    @property
    def psnr(self) -> float:
        """The predicted error on samples that are neither masked nor in shadow, in dB."""
        return self.psnr_of(self.predicted)

    def psnr_of(self, photograph: Singles) -> float:
        """How far a photograph is from the target, on the samples that `psnr` counts, in dB."""
        counted = (self.reach != Reach.MASKED) & (self.reach != Reach.SHADOW)
        missed = (photograph - self.target)[counted] / self.scale
        return float(-10 * np.log10(max(float(np.mean(missed**2)), 1e-12)))

    def as_dict(self) -> dict[str, Any]:
        """Scale, brightness, predicted PSNR, and shares of camera samples; JSON-ready."""
        shares = {name.name.lower(): float((self.reach == name).mean()) for name in Reach}
        return {
            "scale": self.scale, "brightness": self.brightness, "predicted_psnr": self.psnr,
            "uncompensated_psnr": self.uncompensated_psnr, **shares,
            "clipped": float(self.clipped.mean()), **described(self.encoding),
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Compensator:
    """What compensations of one scene share: T, the room's light, and what white reaches."""

    light: JointLight
    # (M,): light without the projector, in camera full scale.
    ambient: Singles
    # (M,): samples that count.
    chosen: NDArray[np.bool_]
    # Whether samples count less whose row of T has a large estimated error.
    weigh_errors: bool = True

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Samples that count and that are not in shadow, (M,)."""
        white = self._by_channel(self.light.white)
        # A sample is in shadow if white gives it less than a tenth of what bright samples of its
        # channel get. Chosen by hand: dark surfaces reflect about a tenth.
        bright = np.quantile(white, 0.9, axis=0)
        lit = ((white > 0.1 * bright) & (white > 0)).ravel() & self.chosen
        if not lit.any():
            hint = "is the mask right, and is there light in the matrix?"
            raise InputError("the projector lights no camera pixel that counts", hint=hint)
        return np.asarray(lit)

    @cached_property
    def white_point(self) -> Singles:
        """The light of wanted white at full brightness, (M,): a median, for each channel."""
        white, lit = self._by_channel(self.light.white), self._by_channel(self.lit)
        medians = [np.median(white[lit[:, c], c]) if lit[:, c].any() else 0 for c in self._channels]
        return np.tile(np.array(medians, np.float32), len(white))

    @cached_property
    def fit(self) -> BoundedFit:
        """The least squares problem; samples in shadow, which nothing helps, do not count."""
        weights = self.lit.astype(np.float32)
        if self.weigh_errors:
            # A sample whose row of T has an estimated error of 0.07 counts half: rows that are
            # wrong would spoil the light of their neighbours, which are right. Chosen on the scenes
            # of benchmarks/separation_scenes.py, where it gains up to 7 dB among metal parts, and
            # 0.03 or 0.15 are worse by up to 1 dB.
            weights *= np.maximum(1 / (1 + (self.light.errors / 0.07) ** 2), 0.01)
        return BoundedFit(self.light, weights)

    @property
    def _channels(self) -> range:
        shape = self.light.camera_shape
        return range(shape[2] if len(shape) == 3 else 1)

    def _by_channel(self, samples: NDArray[Any]) -> NDArray[Any]:
        return samples.reshape(-1, len(self._channels))

    def automatic_brightness(self, wanted: Singles) -> float:
        """The brightness at which one lit sample in 50 asks for more light than white gives it."""
        asked = wanted * self.white_point
        counted = self.lit & (asked > 0)
        if not counted.any():
            raise InputError(
                "the wanted picture is black where the projector lights the scene",
                hint="move the picture, or the mask",
            )
        room = (self.light.white + self.ambient)[counted] / asked[counted]
        # On the bundled scenes half of this share costs 20 to 45 % of the brightness.
        return float(np.quantile(room, 0.02))

    def uncompensated(self, found: Compensation, wanted: Singles) -> Singles:
        """The photograph of the wanted light (M,), shown as it is, as bright as suits best."""
        seen, aim = self.light.forward(self._means(self.lit * wanted)), found.target.ravel()
        factor = seen[self.lit] @ (aim - self.ambient)[self.lit] / max(seen @ seen, 1e-30)
        photograph = np.float32(max(factor, 0)) * seen + self.ambient
        return photograph.reshape(found.target.shape)

    def start(self, target: Singles) -> Singles:
        """The pattern by gains of single pixels, (N,): what inverse methods without T do.

        Each camera sample asks for target / white.
        """
        asked = np.zeros_like(target)
        np.divide(target - self.ambient, self.light.white, out=asked, where=self.lit)
        return self._means(np.clip(asked, 0, 1))

    def _means(self, asked: Singles) -> Singles:
        """For each projector pixel the mean of what the samples ask (M,) that it lights."""
        light, weight = self.light.adjoint(asked), self.light.adjoint(self.lit.astype(np.float32))
        return np.divide(light, weight, out=np.zeros_like(light), where=weight > 0)

    def solve(
        self, wanted: Singles, brightness: float | None, iterations: int = USUAL_ITERATIONS
    ) -> Compensation:
        """Compensate for wanted light (M,) in [0, 1]."""
        if brightness is None:
            brightness = self.automatic_brightness(wanted)
        target = np.float32(brightness) * wanted * self.white_point
        return self.reaching(target, brightness, iterations=iterations)

    def reaching(
        self,
        target: Singles,
        brightness: float,
        *,
        start: Singles | None = None,
        asked: Singles | None = None,
        iterations: int = USUAL_ITERATIONS,
    ) -> Compensation:
        """The compensation for target light (M,), while the solver is asked for `asked` instead.

        `asked` differs where earlier photographs showed that the prediction is wrong.
        """
        first = self.start(target) if start is None else start
        goal = (target if asked is None else asked) - self.ambient
        pattern = self.fit.solve(goal, first, iterations)
        predicted = self.light.forward(pattern) + self.ambient
        reach = np.full(len(target), Reach.REACHED, np.uint8)
        missed, allowed = predicted - target, _CLOSE * brightness * self.white_point
        reach[missed > allowed] = Reach.TOO_BRIGHT
        reach[missed < -allowed] = Reach.TOO_DARK
        reach[~self.lit] = Reach.SHADOW
        reach[~self.chosen] = Reach.MASKED
        scale = self.scale(brightness)
        shape = self.light.camera_shape
        return Compensation(
            self.light.split(pattern), predicted.reshape(shape), target.reshape(shape), scale,
            brightness, reach.reshape(shape), in_colour=self.light.in_colour,
        )  # fmt: skip

    def frame_solver(self, brightness: float) -> Callable[..., tuple[NDArray[Any], NDArray[Any]]]:
        """A function that solves up to 16 frames of a video, (M,) each, after an earlier one.

        It takes them, the pattern (N,) and the picture (M,) before, the array (K, N) to fill, and
        the number of steps. It returns the sum of squared errors of each, and how many samples are
        reached. The equations stand in crates/core/src/frames.rs.
        """
        (matrix,) = self.light.matrices
        sparse, weights = matrix.sparse, self.fit.weights
        usable = self.light.usable
        most = np.ones(matrix.shape[1], np.float32) if usable is None else usable
        bounds = abs(sparse).T @ (weights * (abs(sparse) @ most)) + np.float32(self.fit.ridge)
        white = np.float32(brightness) * self.white_point
        samples = np.stack([white, self.ambient, weights, self.light.white], axis=1)
        pixels = np.stack([bounds, sparse.T @ self.lit.astype(np.float32), most], axis=1)
        cells = grid_cells(matrix.projector_shape, matrix.background_grid)
        parts = (sparse, csr_array(sparse.T), matrix.background, cells, samples, pixels)
        # For all frames two images of the camera and two of the projector, in whole cache lines.
        room = np.empty(2 * _TOGETHER * sum(matrix.shape) + _TOGETHER, np.float32)
        how: dict[str, Any] = {"ridge": self.fit.ridge, "tolerance": _CLOSE}
        return partial(_core.frame_patterns, *parts, room=room, **how)

    def scale(self, brightness: float) -> float:
        """The light of wanted white, a mean over channels; see `Compensation`."""
        return brightness * float(self.white_point[: len(self._channels)].mean())


def compensator(
    transport: Transport | Sequence[Transport],
    *,
    ambient: WantedPicture | None = None,
    mask: WantedPicture | None = None,
    projector_mask: WantedPicture | None = None,
) -> Compensator:
    """What compensations of one scene share, from arguments of `compensate`."""
    light = joint_light(transport)
    shape = light.camera_shape
    if projector_mask is not None:
        shapes = [matrix.projector_shape for matrix in light.matrices]
        usable = [mask_samples(projector_mask, shape, "projector") for shape in shapes]
        light = replace(light, usable=np.concatenate(usable).astype(np.float32))
    return Compensator(light, ambient_samples(ambient, shape), mask_samples(mask, shape))


def compensate(
    transport: Transport | Sequence[Transport],
    wanted: WantedPicture,
    *,
    ambient: WantedPicture | None = None,
    mask: WantedPicture | None = None,
    projector_mask: WantedPicture | None = None,
    brightness: float | None = None,
    gamma: float | None = None,
    fit: str | None = None,
    projector_response: ProjectorResponse | str | Path | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Compensation:
    """The pattern under which the camera sees a wanted picture.

    Solves min over p in [0, 1] of ||W (T p + a - s d)||^2 + r ||p||^2, where d is the wanted
    picture, s its brightness, a the room's light, W the mask times the trust in each row of T, and
    r a small ridge, by FISTA (Beck & Teboulle, "A Fast Iterative Shrinkage-Thresholding Algorithm",
    SIAM J. Imaging Sci. 2009). Rows with a large estimated error count less. T holds what light
    does on its way from surface to surface, so interreflection is compensated too.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path, or several of them
        T, or where `open` finds it. Several: projectors that light one scene together, or the
        primaries of a colour projector, also as the folder that `save_colour` or `estimate` wrote;
        their patterns are found jointly. A store is loaded.
    wanted : (rows, cols) or (rows, cols, channels) array, str or Path
        The picture in [0, 1], as the camera is to see it. Grey for a colour camera: in the colours
        that the scene has under a white pattern. In colour for a grey camera: its luminance.
    ambient : array, str or Path, optional
        Light without the projector, in units of the clip level, such as a black frame. None: none.
    mask : array, str or Path, optional
        0 where the picture does not matter. None: it matters everywhere.
    projector_mask : array, str or Path, optional
        0 for projector pixels that stay black, of the projector's size. None: all give light.
    brightness : float, optional
        The light of wanted white, as a share of what the lit camera pixels see under a white
        pattern (their median), above 0 and at most 10. None: as bright as possible while no more
        than one lit pixel in 50 asks for more light than white gives it.
    gamma : float, optional
        Display gamma of the picture, 0.1 to 10; 1 if it is light. None: 2.2 for files of whole
        levels, such as PNG and JPEG, and 1 for files of floats and arrays.
    fit : {"cover", "contain", "stretch"}, optional
        How a picture of another size is fitted to the camera: it covers all of it and is cut off,
        is seen whole with black beside it, or is stretched. None: it is refused.
    projector_response : ProjectorResponse, str or Path, optional
        What the grey values of the projector are in light, by which the output is encoded: a file
        from `projector_response`, "gamma:2.2", or "linear", which writes light. None: as the
        patterns of T were, or a gamma of 2.2 if these do not tell.
    output : str or Path, optional
        Image file to write the pattern to, to be shown: .png, .tiff, .exr or .npy. Those of the
        primaries become one in colour, those of several projectors NAME-1.png, NAME-2.png, ...
    overwrite : bool
        Whether existing images may be replaced.

    Returns
    -------
    Compensation

    Raises
    ------
    InputError
        On a picture of another size or all black, a mask that leaves nothing, numbers out of range,
        matrices of different cameras, or a store that does not fit into memory.
    OutputError
        If the pattern cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.truth("metal").transport()
    >>> wanted = np.tile(np.linspace(0.2, 1, 64), (64, 1))
    >>> found = lm.compensate(known, wanted, brightness=0.3, output="shown.png")
    >>> lm.read_image("shown.png").shape
    (64, 64)
    """
    check_brightness(brightness)
    check_output(output, IMAGE, overwrite=overwrite)
    shared = compensator(transport, ambient=ambient, mask=mask, projector_mask=projector_mask)
    samples = wanted_samples(wanted, shared.light.camera_shape, gamma=gamma, fit=fit)
    found = shared.solve(samples, brightness)
    plain = found.psnr_of(shared.uncompensated(found, samples))
    encoding = encoding_of(projector_response, shared.light)
    found = replace(found, uncompensated_psnr=plain, encoding=encoding)
    if output is not None:
        write_shown(output, found, overwrite=overwrite)
    return found


def check_brightness(brightness: float | None) -> None:
    """Refuse a brightness that is not above 0; None is automatic."""
    if brightness is not None:
        hint = "give a share of the light of white, such as 0.7 for 70 %, or leave it out"
        check_number("a brightness", brightness, most=10, above=True, hint=hint)


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedVideo(ShortRepr):
    """The patterns for the frames of a video; made by `compensate_video`.

    Parameters
    ----------
    patterns : (K, rows, cols) float32
        In [0, 1].
    brightness, scale : float
        As in `Compensation`, the same for all frames, so that the video does not flicker.
    predicted_psnr : (K,) float64
        The predicted error of each frame in dB.
    reached : (K,) float64
        Share of camera samples that come close to what they should be.
    encoding : ProjectorResponse, optional
        What the images that were written are encoded by; None: they are light.
    """

    patterns: Singles
    brightness: float
    scale: float
    predicted_psnr: NDArray[np.float64]
    reached: NDArray[np.float64]
    encoding: ProjectorResponse | None = None

    def as_dict(self) -> dict[str, Any]:
        """Number of frames, brightness, scale, and the means over the frames; JSON-ready."""
        return {
            "frames": len(self.patterns), "brightness": self.brightness, "scale": self.scale,
            "predicted_psnr": float(self.predicted_psnr.mean()),
            "reached": float(self.reached.mean()), **described([self.encoding]),
        }  # fmt: skip


def compensate_video(
    transport: Transport,
    frames: str | Path | Sequence[WantedPicture] | NDArray[Any],
    *,
    ambient: WantedPicture | None = None,
    mask: WantedPicture | None = None,
    projector_mask: WantedPicture | None = None,
    brightness: float | None = None,
    gamma: float | None = None,
    fit: str | None = None,
    projector_response: ProjectorResponse | str | Path | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> CompensatedVideo:
    """The patterns under which the camera sees the frames of a video.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it.
    frames : (K, rows, cols[, channels]) array, a sequence of images, or a folder or video file
        The wanted pictures; a folder of image files is read in natural order. Video files need the
        extra `video`.
    ambient, mask, projector_mask, brightness, gamma, fit, projector_response
        As in `compensate`. The automatic brightness suits the whole video: each pixel at its
        brightest.
    output : str or Path, optional
        Folder of patterns to write, as `write_patterns` does.
    overwrite : bool
        Whether an existing folder of patterns may be replaced.
    progress : callable, optional
        Called with (done, total) frames after every 16.

    Returns
    -------
    CompensatedVideo

    Raises
    ------
    InputError
        As `compensate`; a frame may be black, all of them may not.
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> fading = [np.full((64, 64), grey) for grey in (0.1, 0.2, 0.3)]
    >>> video = lm.compensate_video(lm.truth("metal").transport(), fading, output="patterns")
    >>> lm.read_patterns("patterns").count
    3
    """
    check_brightness(brightness)
    check_output(output, PATTERNS, overwrite=overwrite)
    shared = compensator(transport, ambient=ambient, mask=mask, projector_mask=projector_mask)
    shared.light.check_single()
    pictures: Any = frames
    if isinstance(frames, str | Path) and Path(frames).is_file():
        pictures = video_frames(frames)
    elif isinstance(frames, str | Path):
        pictures = list_images(frames)
    else:
        check_list(pictures, hint="give the frames of the video, or its file")
    shape = shared.light.camera_shape
    how: dict[str, Any] = {"gamma": gamma, "fit": fit, "levels": isinstance(frames, str | Path)}
    fitted = partial(wanted_samples, camera_shape=shape, black=True, **how)
    wanted = list(work_ahead(fitted, pictures, threads=2))
    if not wanted:
        raise InputError("a video without frames", hint="give at least one frame")
    if brightness is None:
        brightness = shared.automatic_brightness(reduce(np.maximum, wanted))
    (encoding,) = encoding_of(projector_response, shared.light)
    shows = encoding if output is not None else None
    count, matrix = len(wanted), shared.light.matrices[0]
    patterns = np.empty((count, matrix.shape[1]), np.float32)
    shown = patterns if shows is None else np.empty_like(patterns)
    squares, reached = np.empty(count), np.empty(count)
    solve = shared.frame_solver(brightness)
    before = np.zeros(matrix.shape[1], np.float32), np.zeros(matrix.shape[0], np.float32)
    for start in range(0, count, _TOGETHER):
        some = slice(start, start + _TOGETHER)
        steps = _FRAME_STEPS if start else 3 * _FRAME_STEPS
        squares[some], reached[some] = solve(wanted[some], *before, patterns[some], steps=steps)
        before = patterns[some][-1], wanted[some][-1]
        if shows is not None:
            shown[some] = shows.encoded(patterns[some])
        if progress is not None:
            progress(min(start + _TOGETHER, count), count)
    scale = shared.scale(brightness)
    errors = -10 * np.log10(np.maximum(squares / (shared.lit.sum() * scale**2), 1e-12))
    images = (-1, *matrix.projector_shape)
    if output is not None:
        write_patterns(output, ImagePatterns(shown.reshape(images)), overwrite=overwrite)
    reached /= matrix.shape[0]
    patterns = patterns.reshape(images)
    return CompensatedVideo(patterns, brightness, scale, errors, reached, encoding)


def cancel_global(
    transport: Transport,
    pattern: NDArray[Any] | str | Path | None = None,
    *,
    projector_response: ProjectorResponse | str | Path | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Compensation:
    """The pattern under which the camera sees what a pattern gives by direct light only.

    Seitz, Matsushita & Kutulakos ("A Theory of Inverse Light Transport", ICCV 2005) cancel
    interreflections in a photograph by the inverse of T. Here the projector does it: with the
    direct part D of T, that of `separate`, the pattern q with T q = D p makes the camera see D p.
    It is found as `compensate` finds patterns, within [0, 1].

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it.
    pattern : (rows, cols) array, str or Path, optional
        The pattern p in [0, 1]. None: white.
    projector_response, output
        As in `compensate`, of the pattern q.
    overwrite : bool
        Whether an existing image may be replaced.

    Returns
    -------
    Compensation
        Its target is D p. `reach` says where more is left than 5 % of the light of white.

    Raises
    ------
    InputError
        On a pattern of another size, or a T without direct light.
    OutputError
        If the pattern cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.cancel_global(lm.truth("l_objects").transport())
    >>> bool(found.pattern.mean() < 1)
    True
    """
    check_output(output, IMAGE, overwrite=overwrite)
    light = joint_light(transport)
    light.check_single()
    matrix = light.matrices[0]
    shown = pattern_or_white(pattern, matrix.projector_shape)
    target = separate(matrix).direct.relight(shown)
    if not target.any():
        hint = "give a pattern that lights the scene"
        raise InputError("the pattern gives no direct light", hint=hint)
    # The target is made from T, with the same errors, so that no row is trusted less. Twice the
    # usual iterations were chosen by hand.
    shared = replace(compensator(matrix), weigh_errors=False)
    compensation = shared.reaching(
        target.ravel(), 1.0, start=shown.ravel(), iterations=2 * USUAL_ITERATIONS
    )
    compensation = replace(compensation, encoding=encoding_of(projector_response, light))
    if output is not None:
        write_shown(output, compensation, overwrite=overwrite)
    return compensation
