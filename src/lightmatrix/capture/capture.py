"""`Capture`: patterns, the photographs of the scene under them, and how to read these.

Frames stay as they were stored. They are decoded into linear samples tile by tile, in the order
(row, col, channel).
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.correction import Correction
from lightmatrix.capture.decoder import Decoder
from lightmatrix.capture.folder import read_capture, read_folders
from lightmatrix.capture.frames import ArrayStack, CutFrames, Frames, Reader, cut
from lightmatrix.capture.samples import Samples
from lightmatrix.capture.sensor import Sensor
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError
from lightmatrix.files.stacks import is_stack
from lightmatrix.patterns.pattern_set import PatternSet, block_size
from lightmatrix.ranges import check_finite, real_array
from lightmatrix.regions import Region
from lightmatrix.reprs import html_table, jsonable
from lightmatrix.resources.threads import computed_once

# Corner and shape of a rectangle of photographs, in pixels.
Crop = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True, eq=False)
class Capture(Reader):
    """A pattern set and the frames taken under it; see `open`, `from_folders` and `from_arrays`.

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
        What made the capture, JSON-ready.
    surroundings : (array or None, array or None), optional
        The black frame and the mask of which `crop` took a rectangle; see `whole`.
    projector_unknown : bool
        Whether the patterns are grey values whose light `estimate` finds in the frames. They are
        taken as light until then.
    projectors : tuple of (rows, cols)
        The sizes of several projectors that show their patterns at once. The patterns are those of
        all of them, one above the other, each in the upper left of as many rows and columns as the
        largest has. Empty: there is one.
    correction : Correction, optional
        What the rig did to the binned samples, taken out as they are read; see `fit_rig`.
    known : Samples, optional
        The samples, where they are not those of the frames; see `capture_of_samples`.

    Raises
    ------
    InputError
        If the numbers of patterns and frames differ.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns, camera = lm.BernoulliPatterns((8, 8), 16), lm.Sensor()
    >>> frames = np.random.default_rng(0).integers(0, 255, (16, 6, 5)).astype(np.uint8)
    >>> lm.Capture.from_arrays(patterns, frames, camera).bin(camera=2).camera_shape
    (3, 3)
    """

    patterns: PatternSet
    frames: Frames
    decoder: Decoder
    mask: NDArray[np.bool_] | None = None
    bin_projector: tuple[int, int] = (1, 1)
    bin_camera: tuple[int, int] = (1, 1)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    surroundings: tuple[NDArray[Any] | None, NDArray[np.bool_] | None] | None = None
    projector_unknown: bool = False
    projectors: tuple[tuple[int, int], ...] = ()
    correction: Correction | None = None
    known: Samples | None = None

    def __repr__(self) -> str:
        facts = (f"{name}={value}" for name, value in self.summary().items())
        return f"Capture({', '.join(facts)})"

    def _repr_html_(self) -> str:
        return html_table("Capture", self.summary())

    def __post_init__(self) -> None:
        if self.patterns.count != self.frames.count:
            raise InputError(
                f"{self.patterns.count} patterns, but {self.frames.count} images",
                hint="give one image for each pattern, both in natural order; is one missing?",
            )
        if self.projectors:
            rows, cols = (max(sides) for sides in zip(*self.projectors, strict=True))
            if self.projector_shape != (len(self.projectors) * rows, cols):
                raise InputError(
                    f"patterns of {self.patterns.shape} for projectors of {self.projectors}",
                    hint="let patterns hold those of all projectors, one above the other, and do "
                    "not bin their pixels",
                )
        if self.mask is not None and self.mask.shape != self.frames.shape:
            raise InputError(
                f"a mask of shape {self.mask.shape} for images of {self.frames.shape}",
                hint="make the mask as large as the images",
            )

    @classmethod
    def open(
        cls,
        folder: str | Path,
        *,
        crop: Crop | None = None,
        bin_projector: int | tuple[int, int] = 1,
        bin_camera: int | tuple[int, int] = 1,
        allow_outside: bool = False,
    ) -> Self:
        """Read a capture folder or a packed capture, without judging it (see `check`).

        Parameters
        ----------
        folder : str or Path
            Holds patterns/ and images/, or a stack of each such as images.tif; and capture.json,
            unless the camera is linear with exposure 1 and without black level. Or a .zarr that
            `pack` wrote, which is read as far as needed.
        crop : ((int, int), (int, int)), optional
            Corner and shape of a rectangle of the photographs, see `crop`. None: all of them.
        bin_projector, bin_camera : int or (int, int)
            See `bin`.
        allow_outside : bool
            Whether files that capture.json names may lie outside the folder.

        Raises
        ------
        InputError
            On files that cannot be read or do not fit together, naming the file.
        """
        capture = cls(**vars(read_capture(folder, allow_outside=allow_outside)))
        return capture._cut_and_binned(crop, bin_projector, bin_camera)

    @staticmethod
    def lies_at(path: str | Path) -> bool:
        """Whether a path leads to a capture, packed or not, which may still be damaged."""
        entries = Path(path).iterdir() if Path(path).is_dir() else ()
        return {"patterns", "images"} <= {e.stem for e in entries if e.is_dir() or is_stack(e)}

    @classmethod
    def from_folders(
        cls,
        patterns: str | Path | PatternSet,
        images: str | Path,
        settings: ReadSettings | None = None,
        *,
        crop: Crop | None = None,
        bin_projector: int | tuple[int, int] = 1,
        bin_camera: int | tuple[int, int] = 1,
    ) -> Self:
        """A capture from two plain folders of images in natural order, or two stacks.

        Parameters
        ----------
        patterns : str, Path or PatternSet
            Folder of the patterns as projected; a TIFF of several pages, npy or npz file of
            (K, rows, cols); or the set itself.
        images : str or Path
            Folder of the camera's frames, or such a file, (K, rows, cols, 3) in colour.
        settings : ReadSettings, optional
            How the frames are read: levels, exposures, black frame, response, mask. None: like
            those of a linear camera.
        crop, bin_projector, bin_camera
            As for `open`.

        Raises
        ------
        InputError
            On files that cannot be read or do not fit together, naming the file.
        """
        capture = cls(**vars(read_folders(patterns, images, settings or ReadSettings())))
        return capture._cut_and_binned(crop, bin_projector, bin_camera)

    @classmethod
    def from_arrays(
        cls,
        patterns: PatternSet,
        frames: NDArray[Any],
        sensor: Sensor | Decoder,
        *,
        mask: NDArray[np.bool_] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> Self:
        """A capture from frames in memory, such as simulated ones.

        Parameters
        ----------
        patterns : PatternSet
            K patterns.
        frames : (K, rows, cols[, channels]) uint8, uint16 or float32
            Raw levels.
        sensor : Sensor or Decoder
            The camera that took them, or its decoder.
        mask : (rows, cols[, channels]) bool, optional
            Which camera samples count.
        provenance : mapping, optional
            What made the capture, JSON-ready.

        Raises
        ------
        InputError
            On frames that do not fit the patterns.
        """
        array, counts = real_array("frames", frames), None
        if array.ndim not in (3, 4) or array.size == 0:
            hint = "give (K, rows, cols) or (K, rows, cols, 3)"
            raise InputError(f"frames of shape {array.shape}", hint=hint)
        if mask is not None:
            counts = real_array("a mask", mask)
            check_finite("values of a mask", counts)
            counts = np.asarray(counts != 0)
        decoder = sensor.decoder() if isinstance(sensor, Sensor) else sensor
        capture = cls(patterns, ArrayStack(array), decoder, counts, provenance=provenance or {})
        capture.decoder.check_count(capture.count, array[0].size)
        return capture

    def _cut_and_binned(self, crop: Crop | None, *blocks: int | tuple[int, int]) -> Self:
        self.decoder.check_count(self.count)
        whole = self if crop is None else self.crop(*crop)
        return whole.bin(*blocks)

    @property
    def count(self) -> int:
        """Number of frames K."""
        return self.frames.count

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Projector rows and columns, binned."""
        return self.patterns.shape

    @property
    def reference_level(self) -> float:
        """Clip level of the longest exposure, as a sample at exposure 1: the unit of a row of T."""
        return float(1 / self.exposures.max())

    def crop(self, corner: tuple[int, int], shape: tuple[int, int]) -> Self:
        """A rectangle of the photographs, cut out of each as it is read.

        Pixels outside of it take no memory, and no time beyond that of reading a photograph. The
        provenance of an estimate says where the rectangle lay.

        Parameters
        ----------
        corner : (int, int)
            Row and column of its first camera pixel, not binned.
        shape : (int, int)
            Its rows and columns, not binned.

        Raises
        ------
        InputError
            If the rectangle leaves the photographs, or the capture is binned already.

        Examples
        --------
        >>> import lightmatrix as lm
        >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 8))
        >>> capture.crop((10, 20), (32, 40)).bin(camera=2).camera_shape
        (16, 20)
        """
        if self.bin_camera != (1, 1):
            raise InputError("the capture is binned already", hint="crop it first, then bin it")
        frames = cut(self.frames, corner, shape)
        rows, cols = self.frames.shape[:2]
        inside = Region(corner, shape, (rows, cols)).slices
        decoder = self.decoder
        if decoder.black_frame is not None:
            black = decoder.black_frame.reshape(self.frames.shape)[inside]
            decoder = replace(decoder, black_frame=black.ravel())
        mask = None if self.mask is None else self.mask[inside]
        around = self.surroundings or (self.decoder.black_frame, self.mask)
        return replace(
            self, frames=frames, decoder=decoder, mask=mask, surroundings=around,
            correction=self.correction and self.correction.window(*inside, self.camera_shape),
        )  # fmt: skip

    @property
    def whole(self) -> Self:
        """The capture of whole photographs, of which `crop` took a rectangle; else itself."""
        if self.surroundings is None or not isinstance(self.frames, CutFrames):
            return self
        black, mask = self.surroundings
        decoder = replace(self.decoder, black_frame=black)
        whole = replace(self, frames=self.frames.frames, decoder=decoder, mask=mask)
        return replace(whole, bin_camera=(1, 1), surroundings=None, correction=None)

    def window(self, rows: slice, cols: slice) -> Self:
        """The capture of a rectangle of its binned camera pixels; slices with start and stop."""
        height, width = self.frames.shape[:2]
        down, across = self.bin_camera
        corner = (rows.start * down, cols.start * across)
        correction = self.correction and self.correction.window(rows, cols, self.camera_shape)
        end = (min(rows.stop * down, height), min(cols.stop * across, width))
        whole = replace(self, bin_camera=(1, 1), correction=None)
        part = whole.crop(corner, (end[0] - corner[0], end[1] - corner[1]))
        return replace(part, bin_camera=self.bin_camera, surroundings=None, correction=correction)

    def bin(self, projector: int | tuple[int, int] = 1, camera: int | tuple[int, int] = 1) -> Self:
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
        blocks = block_size(projector, "projector"), block_size(camera, "camera")
        for name, block in zip(("bin_projector", "bin_camera"), blocks, strict=True):
            if block != (1, 1) and getattr(self, name) != (1, 1):
                hint = "bin it once"
                raise InputError(f"the capture is binned already, {getattr(self, name)}", hint=hint)
        result = self
        if blocks[0] != (1, 1):
            coarse = self.patterns.coarse(blocks[0])
            result = replace(self, patterns=coarse, bin_projector=blocks[0])
        return result if blocks[1] == (1, 1) else replace(result, bin_camera=blocks[1])

    def select(self, frames: Sequence[int] | NDArray[np.integer]) -> Self:
        """The capture of some frames, given by their indices."""
        index = np.asarray(frames, np.int64)
        return replace(
            self,
            patterns=self.patterns.subset(index),
            frames=self.frames.select([int(k) for k in index]),
            decoder=self.decoder.select(index),
            correction=self.correction and self.correction.select(index),
        )

    def frame(self, index: int) -> NDArray[Any]:
        """Raw levels of one frame as stored, not binned."""
        return self.frames.read(index)

    @computed_once
    def clipped_share(self) -> float:
        """Share of the valid samples that are clipped."""
        clipped = sum(int(tile.clipped.sum()) for _, tile in self.tiles())
        return clipped / max(1, int(self.valid.sum()) * self.count)

    @computed_once
    def digest(self) -> str:
        """Hash of the patterns and of all samples, 16 hex digits."""
        hasher = hashlib.sha256(self.patterns.digest.encode())
        hasher.update(repr((self.camera_shape, self.projector_shape)).encode())
        for _, tile in self.tiles():
            for array in (tile.values, tile.clipped, tile.clip_level, tile.weights):
                if array is not None:
                    hasher.update(np.ascontiguousarray(array).tobytes())
        return hasher.hexdigest()[:16]

    def summary(self) -> dict[str, Any]:
        """Number of frames, shapes, kind of patterns, levels and exposures, by name."""
        exposures = np.unique(self.exposures)
        # Four different exposures are listed, and the others counted.
        listed = ", ".join(f"{exposure:g}" for exposure in exposures[:4])
        if len(exposures) > 4:
            listed += f" and {len(exposures) - 4} more"
        faults = self.provenance.get("faults")
        # The provenance of a foreign capture may hold anything.
        faults = faults if isinstance(faults, dict) else {}
        stated = ", ".join(f"{name} {amount}" for name, amount in faults.items())
        return {
            "frames": self.count,
            "camera": " x ".join(map(str, self.camera_shape)),
            "projector": " x ".join(map(str, self.projector_shape)),
            "patterns": type(self.patterns).__name__,
            "levels": str(self.frames.dtype),
            "exposure": listed,
        } | ({"simulated faults": stated} if stated else {})

    @property
    def description(self) -> dict[str, Any]:
        """Shapes and settings of the capture, JSON-ready, with its provenance."""
        decoder, frames = self.decoder, self.frames
        cropped = {"crop": frames.region.as_dict()} if isinstance(frames, CutFrames) else {}
        return {
            **cropped, "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape), "frames": self.count,
            "bin_camera": list(self.bin_camera), "bin_projector": list(self.bin_projector),
            "clip": jsonable(decoder.clip), "black_level": jsonable(decoder.black_level),
            "black_frame": decoder.black_frame is not None, "exposure": jsonable(decoder.exposure),
            "response": decoder.response.name, "masked": int((~self.valid).sum()),
            **self.provenance,
        }  # fmt: skip


def open_capture(capture: Capture | str | Path) -> Capture:
    """The capture itself, or the one that a capture folder or packed capture holds."""
    return capture if isinstance(capture, Capture) else Capture.open(capture)


def capture_of_samples(
    patterns: PatternSet, samples: Samples, camera_shape: tuple[int, ...], exposure: float
) -> Capture:
    """A capture of samples (M, K) that were computed from those of another one.

    They are in units of the clip level at exposure 1.
    """
    # Frames of no memory, which nothing reads.
    frames = np.broadcast_to(np.float32(0), (patterns.count, *camera_shape))
    decoder = Decoder(clip=1.0, full_scale=1.0, exposure=exposure)
    return Capture(patterns, ArrayStack(frames), decoder, known=samples)
