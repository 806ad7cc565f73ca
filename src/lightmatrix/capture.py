"""Captures: patterns, the photographs of the scene under them, and how to read these.

On disk a capture is a folder::

    patterns/      one image a pattern, and patterns.json if they can be remade
    images/        one image a frame, in the same natural order
    capture.json   exposure, clip and black level, response, ... (all optional)

or just two folders of images. Frames stay as they were stored; they become linear samples tile by
tile, in the order (row, col, channel).
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightmatrix.atomic import atomic_folder
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.frame_order import check_order
from lightmatrix.images import ImageStack, nonlinear_tag, read_image, write_image
from lightmatrix.pattern_folder import (
    fill_pattern_folder,
    read_json,
    read_patterns,
    write_patterns,
)
from lightmatrix.patterns import ImagePatterns, PatternSet
from lightmatrix.sensor import Decoded, Decoder, Response, Sensor, bin_samples

__all__ = [
    "ArrayStack",
    "Capture",
    "Frames",
    "Samples",
    "read_patterns",
    "write_capture",
    "write_patterns",
]

DESCRIPTION = "capture.json"
FORMAT, VERSION = "lightmatrix-capture", 1
_KEYS = frozenset({"format", "version", "projector_shape", "camera_shape", "provenance"}) | {
    "exposure",
    "clip",
    "black_level",
    "full_scale",
    "response",
    "black",
    "mask",
}
# Raw frames up to this size are held in memory, larger ones in a temporary file.
_MEMORY_BYTES = 2 << 30
# Ends of the range of cameras whose levels are stored in 16 bits, low or high aligned.
_TOPS_IN_16_BITS = (1023, 4095, 16383, 65472, 65520, 65532)


class Frames(Protocol):
    """A stack of frames of one shape and type, read one at a time."""

    @property
    def count(self) -> int:
        """Number of frames K."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols) or (rows, cols, channels) of a frame."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """uint8, uint16 or float32."""

    def read(self, index: int) -> NDArray[Any]:
        """One frame as it is stored."""

    def select(self, index: Sequence[int]) -> Frames:
        """The frames of the given indices."""


@dataclass(frozen=True, eq=False)
class ArrayStack:
    """Frames that are in memory already, such as simulated ones.

    Parameters
    ----------
    array : (K, rows, cols) or (K, rows, cols, channels) uint8, uint16 or float32
    """

    array: NDArray[Any]

    @property
    def count(self) -> int:
        """Number of frames K."""
        return len(self.array)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a frame."""
        return self.array.shape[1:]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the levels."""
        return self.array.dtype

    def read(self, index: int) -> NDArray[Any]:
        """One frame."""
        frame: NDArray[Any] = self.array[index]
        return frame

    def select(self, index: Sequence[int]) -> ArrayStack:
        """The frames of the given indices."""
        return ArrayStack(self.array[list(index)])


@dataclass(frozen=True)
class Samples(Decoded):
    """Linear camera samples of m rows under K patterns, every one with its own clip state.

    Parameters
    ----------
    values : (m, K) float32
        At exposure 1, in units of the clip level; where clipped, a lower bound.
    clipped : (m, K) bool
        Whether the sample, or any camera pixel binned into it, is clipped.
    clip_level : (K,) or (m, K) float32
        Where each sample clips.
    weights : (m, K) or (K,) float32, optional
        0 masks a sample; frames of lower exposure weigh less. None means all 1.
    """

    weights: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Capture:
    """A pattern set and the frames taken under it.

    Made by `open`, `from_folders` or `from_arrays`.

    Parameters
    ----------
    patterns : PatternSet
        K patterns, binned.
    frames : Frames
        K frames, not binned.
    decoder : Decoder
        From raw levels to linear samples.
    mask : shape of a frame, bool, optional
        Which camera samples count.
    bin_projector, bin_camera : (int, int)
        Rows and columns of the blocks that are averaged.
    provenance : mapping
        What made it, JSON-ready.

    Raises
    ------
    InputError
        If the numbers of patterns and frames differ.
    """

    patterns: PatternSet
    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None = None
    bin_projector: tuple[int, int] = (1, 1)
    bin_camera: tuple[int, int] = (1, 1)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.patterns.count != self.frames.count:
            raise InputError(
                f"{self.patterns.count} patterns, but {self.frames.count} images",
                hint="give one image for each pattern, both in natural order; is one missing?",
            )
        if self.mask is not None and self.mask.shape != self.frames.shape:
            raise InputError(
                f"a mask of shape {self.mask.shape} for images of {self.frames.shape}",
                hint="make the mask as large as the images",
            )

    # ---- making one

    @classmethod
    def open(
        cls,
        folder: str | Path,
        *,
        bin_projector: int | tuple[int, int] = 1,
        bin_camera: int | tuple[int, int] = 1,
        check: bool = True,
        check_order: bool = True,
    ) -> Capture:
        """Read a capture folder.

        Parameters
        ----------
        folder : str or Path
            Holds patterns/, images/ and, for anything but a linear camera of exposure 1 without
            black level, capture.json.
        bin_projector, bin_camera : int or (int, int)
            See `bin`.
        check, check_order : bool
            See `check`.

        Raises
        ------
        InputError
            On anything that makes the capture unusable, naming the file.
        """
        place = Path(folder)
        if not place.is_dir():
            problem = "is a file, not a capture folder" if place.exists() else "no such folder"
            raise InputError(f"{place}: {problem}", hint="give a folder with patterns/ and images/")
        for name in ("patterns", "images"):
            if not (place / name).is_dir():
                raise InputError(
                    f"{place}: has no folder {name}/",
                    hint="give a folder with patterns/ and images/, or --patterns and --images",
                )
        content = {}
        if (place / DESCRIPTION).exists():
            content = read_json(place / DESCRIPTION, FORMAT, VERSION)
        capture = cls._described(place, content)
        return capture._finish(bin_projector, bin_camera, check, check_order)

    @classmethod
    def from_folders(
        cls,
        patterns: str | Path | PatternSet,
        images: str | Path,
        *,
        black: str | Path | float | None = None,
        white: str | Path | None = None,
        clip: float | NDArray[Any] | None = None,
        response: Response | str | None = None,
        exposure: float | NDArray[Any] = 1.0,
        mask: str | Path | None = None,
        bin_projector: int | tuple[int, int] = 1,
        bin_camera: int | tuple[int, int] = 1,
        check: bool = True,
        check_order: bool = True,
    ) -> Capture:
        """A capture from two plain folders of images, in natural order.

        Parameters
        ----------
        patterns : str, Path or PatternSet
            Folder of the patterns as projected, or the set itself.
        images : str or Path
            Folder of the camera's frames.
        black : str, Path or float, optional
            Image under a black pattern, or the camera's black level in raw levels.
        white : str or Path, optional
            Image under a white pattern; becomes one more frame.
        clip : float or (K,), optional
            Raw level at which the camera clips; None means the end of the range.
        response : Response or str, optional
            See `Response.parse`; None means linear, and warns where the files say otherwise.
        exposure : float or (K,)
            Exposure of each frame.
        mask : str or Path, optional
            Image that is 0 where camera pixels are to be left out.
        bin_projector, bin_camera : int or (int, int)
            See `bin`.
        check, check_order : bool
            See `check`.

        Raises
        ------
        InputError
            On anything that makes the capture unusable, naming the file.
        """
        shown = patterns if isinstance(patterns, PatternSet) else read_patterns(patterns)
        stack = ImageStack.open(images)
        if shown.count != stack.count:
            where = "" if isinstance(patterns, PatternSet) else f" in {patterns}"
            raise InputError(
                f"{shown.count} patterns{where}, but {stack.count} images in {images}",
                hint="give one image for each pattern, both in natural order; is one missing?",
            )
        if white is not None:
            shown = ImagePatterns(np.concatenate([shown.images(), np.ones((1, *shown.shape))]))
            stack = _with_frame(stack, Path(white))
        _warn_if_tagged(stack, response)
        decoder = _decoder(
            stack,
            clip=clip,
            response=response,
            exposure=exposure,
            black=black,
        )
        capture = cls(shown, stack, decoder, _read_mask(mask, stack.shape))
        return capture._finish(bin_projector, bin_camera, check, check_order)

    @classmethod
    def from_arrays(
        cls,
        patterns: PatternSet,
        frames: NDArray[Any],
        sensor: Sensor | Decoder,
        *,
        mask: NDArray[np.bool_] | None = None,
        provenance: Mapping[str, Any] | None = None,
        check: bool = True,
        check_order: bool = False,
    ) -> Capture:
        """A capture from frames in memory, (K, rows, cols[, channels]), such as simulated ones."""
        decoder = sensor.decoder() if isinstance(sensor, Sensor) else sensor
        capture = cls(patterns, ArrayStack(frames), decoder, mask, provenance=provenance or {})
        return capture._finish(1, 1, check, check_order)

    @classmethod
    def _described(cls, place: Path, content: Mapping[str, Any]) -> Capture:
        file = place / DESCRIPTION
        unknown = sorted(set(content) - _KEYS)
        if unknown:
            raise InputError(
                f"{file}: does not know {', '.join(map(repr, unknown))}",
                hint=f"its keys are {', '.join(sorted(_KEYS))}",
            )
        shown = read_patterns(place / "patterns")
        stack = ImageStack.open(place / "images")
        for key, shape, what in (
            ("projector_shape", shown.shape, "patterns"),
            ("camera_shape", stack.shape, "images"),
        ):
            if key in content and tuple(np.ravel(content[key])) != tuple(shape):
                raise InputError(
                    f"{file}: {key} is {content[key]}, but the {what} have {list(shape)}",
                    hint="correct capture.json, or restore the folder",
                )
        response = content.get("response")
        _warn_if_tagged(stack, response)
        black = content.get("black")
        try:
            decoder = _decoder(
                stack,
                clip=_numbers(content.get("clip")),
                response=None if response is None else Response.parse(str(response), place),
                exposure=_numbers(content.get("exposure", 1.0)),
                black=None if black is None else place / str(black["file"]),
                black_level=_numbers(content.get("black_level")),
                black_exposure=None if black is None else black.get("exposure"),
                full_scale=content.get("full_scale"),
            )
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(
                f"{file}: cannot be understood ({error})", hint="see docs/captures.md"
            ) from error
        mask = content.get("mask")
        return cls(
            shown,
            stack,
            decoder,
            _read_mask(None if mask is None else place / str(mask), stack.shape),
            provenance=dict(content.get("provenance") or {}),
        )

    def _finish(
        self,
        bin_projector: int | tuple[int, int],
        bin_camera: int | tuple[int, int],
        check: bool,
        order: bool,
    ) -> Capture:
        _check_per_frame(self.decoder, self.count)
        capture = self.bin(bin_projector, bin_camera)
        if check:
            capture.check(order=order)
        return capture

    # ---- shape

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.frames.count

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Projector rows and columns, binned."""
        return self.patterns.shape

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Camera rows, columns and, for a colour camera, channels, binned."""
        rows, cols, *channels = self.frames.shape
        return (-(-rows // self.bin_camera[0]), -(-cols // self.bin_camera[1]), *channels)

    @property
    def rows(self) -> int:
        """Number of camera samples M, binned."""
        return int(np.prod(self.camera_shape))

    @property
    def exposures(self) -> NDArray[np.float64]:
        """Exposure of each frame, (K,)."""
        return np.broadcast_to(np.asarray(self.decoder.exposure, np.float64), (self.count,))

    @property
    def reference_level(self) -> float:
        """Clip level of the longest exposed frames at exposure 1: the natural unit of a row."""
        return float(1 / self.exposures.max())

    def bin(
        self, projector: int | tuple[int, int] = 1, camera: int | tuple[int, int] = 1
    ) -> Capture:
        """Average blocks of projector and of camera pixels.

        A camera sample is then clipped if any of its pixels is; patterns become grey.

        Parameters
        ----------
        projector, camera : int or (int, int)
            Rows and columns of a block; blocks at the border may be smaller.

        Raises
        ------
        InputError
            If a block is empty or the capture is binned already.
        """
        blocks = _pair(projector, "projector"), _pair(camera, "camera")
        result = self
        for name, block in zip(("bin_projector", "bin_camera"), blocks, strict=True):
            if block != (1, 1) and getattr(self, name) != (1, 1):
                raise InputError(
                    f"the capture is binned already, {getattr(self, name)}", hint="bin it once"
                )
        if blocks[0] != (1, 1):
            coarse = self.patterns.coarse(blocks[0])
            result = replace(result, patterns=coarse, bin_projector=blocks[0])
        if blocks[1] != (1, 1):
            result = replace(result, bin_camera=blocks[1])
        return result

    def select(self, frames: Sequence[int] | NDArray[np.integer]) -> Capture:
        """The capture of the frames of the given indices, such as all but one."""
        index = np.asarray(frames, np.int64)
        decoder = replace(
            self.decoder,
            **{
                name: value[index] if np.ndim(value := getattr(self.decoder, name)) else value
                for name in ("clip", "black_level", "exposure")
            },
        )
        return replace(
            self,
            patterns=self.patterns.subset(index),
            frames=self.frames.select([int(k) for k in index]),
            decoder=decoder,
        )

    # ---- samples

    def frame(self, index: int) -> NDArray[Any]:
        """Raw levels of one frame as stored, not binned."""
        return self.frames.read(index)

    def samples(self, start: int = 0, stop: int | None = None) -> Samples:
        """Linear samples of the camera rows start..stop, decoded from the raw frames.

        Returns
        -------
        Samples
            Fits `Problem`; at exposure 1, in units of the clip level.
        """
        end = self.rows if stop is None else min(stop, self.rows)
        if self.bin_camera == (1, 1):
            decoded = self.decoder.decode(self._raw[start:end], first_row=start)
        else:
            whole = self._binned
            level = whole.clip_level if whole.clip_level.ndim == 1 else whole.clip_level[start:end]
            decoded = Decoded(whole.values[start:end], whole.clipped[start:end], level)
        valid = self.valid[start:end]
        weights = self._frame_weights
        if valid.all():
            return Samples(decoded.values, decoded.clipped, decoded.clip_level, weights)
        if weights is None:
            weights = np.ones(self.count, np.float32)
        return Samples(
            decoded.values * valid[:, None],
            decoded.clipped & valid[:, None],
            decoded.clip_level,
            valid[:, None] * weights,
        )

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Which camera samples count: not masked, and not clipped without light; (M,)."""
        if self.bin_camera == (1, 1):
            return self._valid_pixels
        nothing = np.zeros((len(self._valid_pixels), 1), np.float32)
        empty = Decoded(nothing, nothing > 0, np.ones(1, np.float32))
        return bin_samples(empty, self._valid_pixels, self.frames.shape, self.bin_camera)[1]

    @cached_property
    def _valid_pixels(self) -> NDArray[np.bool_]:
        hot = self.decoder.hot
        valid = np.ones(int(np.prod(self.frames.shape)), bool) if hot is None else ~hot
        return valid if self.mask is None else valid & self.mask.ravel()

    @property
    def _frame_weights(self) -> NDArray[np.float32] | None:
        # The noise of a sample divided by its exposure e grows by 1/e. Relative to the longest
        # exposure, so that equal exposures weigh 1, however long they are.
        relative = self.exposures / self.exposures.max()
        return None if (relative == 1).all() else (relative**2).astype(np.float32)

    @cached_property
    def _raw(self) -> NDArray[Any]:
        """Raw levels (M, K), a camera sample's frames side by side as tiles need them."""
        pixels = int(np.prod(self.frames.shape))
        raw = _allocate((pixels, self.count), self.frames.dtype)
        # Some frames at a time: column by column would touch every page of the array K times.
        group = max(1, min(64, (256 << 20) // max(1, pixels * raw.itemsize)))
        for start in range(0, self.count, group):
            stop = min(start + group, self.count)
            block = [self.frames.read(k).reshape(-1) for k in range(start, stop)]
            raw[:, start:stop] = np.stack(block, axis=1)
        return raw

    @cached_property
    def _binned(self) -> Decoded:
        """Binned samples (M, K); smaller than the raw levels for blocks of 2 x 2 and more."""
        values = _allocate((self.rows, self.count), np.dtype(np.float32))
        clipped = _allocate((self.rows, self.count), np.dtype(np.bool_))
        levels = []
        for k in range(self.count):
            raw = self.frames.read(k).reshape(-1, 1)
            decoded = self.decoder.decode(raw, first_frame=k)
            binned, _ = bin_samples(decoded, self._valid_pixels, self.frames.shape, self.bin_camera)
            values[:, k], clipped[:, k] = binned.values[:, 0], binned.clipped[:, 0]
            levels.append(binned.clip_level)
        if levels[0].ndim == 1:
            level = np.concatenate(levels)
        elif np.ptp(self.exposures) == 0 and np.ndim(self.decoder.clip) == 0:
            level = np.broadcast_to(levels[0], values.shape)
        else:
            level = np.concatenate(levels, axis=1)
        return Decoded(values, clipped, level)

    def tiles(self, rows: int = 4096) -> Iterable[tuple[int, Samples]]:
        """Iterate over (first row, samples) of the whole camera."""
        for start in range(0, self.rows, rows):
            yield start, self.samples(start, start + rows)

    @cached_property
    def clipped_share(self) -> float:
        """Share of the samples that count that are clipped."""
        clipped = sum(int(tile.clipped.sum()) for _, tile in self.tiles())
        return clipped / max(1, int(self.valid.sum()) * self.count)

    @cached_property
    def digest(self) -> str:
        """Hash of the patterns and of all samples, 16 hex digits."""
        hasher = hashlib.sha256(self.patterns.digest.encode())
        hasher.update(repr((self.camera_shape, self.projector_shape)).encode())
        for _, tile in self.tiles():
            for array in (tile.values, tile.clipped, tile.clip_level, tile.weights):
                if array is not None:
                    hasher.update(np.ascontiguousarray(array).tobytes())
        return hasher.hexdigest()[:16]

    @property
    def description(self) -> dict[str, Any]:
        """What the capture is and how it is read, JSON-ready."""
        return {
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "frames": self.count,
            "bin_camera": list(self.bin_camera),
            "bin_projector": list(self.bin_projector),
            "clip": _jsonable(self.decoder.clip),
            "black_level": _jsonable(self.decoder.black_level),
            "black_frame": self.decoder.black_frame is not None,
            "exposure": _jsonable(self.decoder.exposure),
            "response": self.decoder.response.name,
            "masked": int((~self.valid).sum()),
            **dict(self.provenance),
        }

    # ---- checks

    def check(self, *, order: bool = True) -> None:
        """Refuse what no estimate can come from.

        Parameters
        ----------
        order : bool
            Also look for frames that do not follow the patterns (swapped, missing, late).

        Raises
        ------
        InputError
            With one frame only, a projector of one pixel, no pattern that varies, nothing but
            dark or clipped samples, all pixels masked, or frames out of order.
        """
        if self.count == 1:
            raise InputError(
                "the capture has 1 frame only", hint="take at least 2 patterns, better 64 or more"
            )
        if self.patterns.pixels == 1:
            raise InputError(
                "the projector has 1 x 1 pixels", hint="use larger patterns or bin them less"
            )
        self._check_patterns()
        if not self.valid.any():
            raise InputError("all camera pixels are masked", hint="correct the mask")
        self._check_light()
        if order:
            check_order(self.patterns, self.tiles(), self.rows)

    def _check_patterns(self) -> None:
        first = self.patterns.rows(0, 1)[0]
        # After binning, equal pixels may differ in the last bit.
        alike, flat = True, True
        for _, block in self.patterns.blocks():
            flat = flat and bool((np.ptp(block, axis=1) < 1e-6).all())
            alike = alike and bool((np.abs(block - first) < 1e-6).all())
        if flat:
            raise InputError(
                "no pattern varies: each shows one grey value all over",
                hint="use other patterns, or bin the projector less",
            )
        if alike:
            raise InputError("all patterns are the same", hint="use patterns that differ")

    def _check_light(self) -> None:
        brightest, clipped, tops = 0.0, 0, 0
        for _, tile in self.tiles():
            relative = tile.values / np.broadcast_to(tile.clip_level, tile.values.shape)
            brightest = max(brightest, float(relative.max(initial=0)))
            clipped += int(tile.clipped.sum())
        total = int(self.valid.sum()) * self.count
        # Two levels above black are no signal.
        quanta = 2 / float(np.min(np.asarray(self.decoder.clip) - self.decoder.black_level))
        if brightest <= (quanta if self.frames.dtype.kind == "u" else 1e-6):
            raise InputError(
                "all images are dark: no sample rises above the black level",
                hint="expose longer, and check the black frame and black level",
            )
        if clipped > 0.99 * total:
            raise InputError(
                f"{100 * clipped / total:.1f} % of the samples are clipped",
                hint="expose so that most samples stay below the clip level; 1 to 20 % may clip",
            )
        if self.frames.dtype == np.uint16 and self.bin_camera == (1, 1):
            top = int(self._raw.max())
            tops = int((self._raw == top).sum())
            if top in _TOPS_IN_16_BITS and top < np.min(self.decoder.clip) and tops > 3:
                warnings.warn(
                    f"{tops} samples are exactly {top}, the brightest level, which many cameras "
                    f"clip at, but the clip level is {np.min(self.decoder.clip):g}: should it be "
                    f"{top}?",
                    LightMatrixWarning,
                    stacklevel=2,
                )


def write_capture(
    folder: str | Path,
    patterns: PatternSet,
    frames: NDArray[Any] | Iterable[NDArray[Any]],
    *,
    sensor: Sensor,
    camera_shape: tuple[int, ...] | None = None,
    black: NDArray[Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a capture folder, whole or not at all.

    Parameters
    ----------
    folder : str or Path
        The folder to make.
    patterns : PatternSet
        K patterns.
    frames : (K, rows, cols[, channels]) array or iterable of K images
        Raw levels, written as PNG (uint8, uint16) or npy (float32).
    sensor : Sensor
        The camera that took them.
    camera_shape : tuple of int, optional
        Shape that each frame must have.
    black : (rows, cols[, channels]), optional
        Raw levels under a black pattern, at the exposure of the frames.
    provenance : mapping, optional
        What made the capture, JSON-ready.
    overwrite : bool
        Whether an existing capture may be replaced.

    Raises
    ------
    InputError
        If the number or shape of the frames is wrong.
    OutputError
        If the folder exists or cannot be written.
    """
    suffix = ".png" if sensor.bits else ".npy"
    digits = max(4, len(str(patterns.count - 1)))
    with atomic_folder(folder, overwrite=overwrite) as part:
        (part / "patterns").mkdir()
        (part / "images").mkdir()
        fill_pattern_folder(part / "patterns", patterns)
        shape, count = camera_shape, 0
        for count, frame in enumerate(frames, 1):
            shape = shape or frame.shape
            if frame.shape != shape:
                raise InputError(
                    f"frame {count - 1} has shape {frame.shape}, expected {shape}",
                    hint="give frames of one shape",
                )
            write_image(part / "images" / f"image_{count - 1:0{digits}d}{suffix}", frame)
        if count != patterns.count:
            raise InputError(
                f"{count} frames for {patterns.count} patterns", hint="give one a pattern"
            )
        content: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "projector_shape": list(patterns.shape),
            "camera_shape": list(shape or ()),
            "exposure": _jsonable(sensor.exposure),
            "clip": _jsonable(sensor.decoder().clip),
            "black_level": sensor.black_level,
            "full_scale": sensor.full_scale,
            "response": "linear",
            "provenance": dict(provenance or {}),
        }
        if black is not None:
            write_image(part / f"black{suffix}", black)
            content["black"] = {"file": f"black{suffix}"}
        text = json.dumps(content, indent=2, default=_jsonable)
        (part / DESCRIPTION).write_text(text + "\n")


def _decoder(
    stack: ImageStack,
    *,
    clip: float | NDArray[Any] | None,
    response: Response | str | None,
    exposure: float | NDArray[Any] | None,
    black: str | Path | float | None,
    black_level: float | NDArray[Any] | None = None,
    black_exposure: float | None = None,
    full_scale: float | None = None,
) -> Decoder:
    if full_scale is None:
        full_scale = 1.0 if stack.dtype.kind == "f" else float(np.iinfo(stack.dtype).max)
    if response is None or isinstance(response, str):
        response = Response.parse(response or "linear")
    black_frame = None
    if isinstance(black, (int, float)):
        black_level = float(black)
    elif black is not None:
        image = read_image(black)
        if image.shape != stack.shape:
            raise InputError(
                f"{black}: the black frame has shape {image.shape}, the images {stack.shape}",
                hint="take the black frame with the same camera settings",
            )
        black_frame = image.ravel()
        if black_level is None:
            # Without a stated pedestal the scale is that of a typical pixel.
            black_level = float(np.median(black_frame))
    clip = full_scale if clip is None else clip
    if black_frame is not None and black_level is not None and black_level >= np.min(clip):
        raise InputError(
            f"{black}: the black frame is clipped", hint="take it with the projector showing black"
        )
    return Decoder(
        clip,
        full_scale,
        0.0 if black_level is None else black_level,
        response,
        1.0 if exposure is None else exposure,
        black_frame,
        black_exposure,
    )


def _check_per_frame(decoder: Decoder, count: int) -> None:
    for name in ("clip", "black_level", "exposure"):
        value = np.asarray(getattr(decoder, name))
        if value.ndim and value.shape != (count,):
            raise InputError(
                f"{name} has {value.size} values for {count} frames",
                hint="give one number, or one for each frame",
            )


def _read_mask(mask: str | Path | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    if mask is None:
        return None
    image = read_image(mask)
    if image.ndim == 2 and len(shape) == 3 and image.shape == shape[:2]:
        image = np.repeat(image[..., None], shape[2], axis=2)
    if image.shape != shape:
        raise InputError(
            f"{mask}: the mask has shape {image.shape}, the images {shape}",
            hint="make the mask as large as the images",
        )
    return np.asarray(image > 0)


def _with_frame(stack: ImageStack, path: Path) -> ImageStack:
    return ImageStack((*stack.paths, path), stack.shape, stack.dtype)


def _warn_if_tagged(stack: ImageStack, response: object) -> None:
    tag = nonlinear_tag(stack.paths[0]) if response is None else None
    if tag is not None:
        warnings.warn(
            f"{stack.paths[0]}: {tag}, so probably not linear, but no response is given; "
            "give one (srgb, gamma:2.2, ...), or linear if it is",
            LightMatrixWarning,
            stacklevel=2,
        )


def _allocate(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    if int(np.prod(shape)) * dtype.itemsize <= _MEMORY_BYTES:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile() as file:
        # The mapping keeps the unnamed file alive; it vanishes with the array.
        return np.memmap(file, dtype, "w+", shape=shape)


def _pair(block: int | tuple[int, int], name: str) -> tuple[int, int]:
    rows, cols = (block, block) if isinstance(block, (int, np.integer)) else block
    if min(rows, cols) < 1:
        raise InputError(
            f"the {name} binned by {rows} x {cols} pixels", hint="use at least 1, such as 8"
        )
    return int(rows), int(cols)


def _numbers(value: Any) -> Any:
    return np.asarray(value, np.float64) if isinstance(value, list) else value


def _jsonable(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value
