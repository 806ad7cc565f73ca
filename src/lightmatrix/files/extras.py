"""Files that optional libraries read: EXR by OpenEXR and raw camera files by LibRaw; and OpenCV.

EXR files are pictures in linear float. Raw files (DNG, CR2, NEF, ARW, ...) come as light: black
subtracted, 1 where the sensor clips. LibRaw reads them without white balance, colour matrix, gamma
or brightening, so that the levels of each channel stay proportional to light.
"""

import importlib
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.files.reading import check_image_size

# Endings of raw camera files.
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
_EXR_COLOURS, _EXR_ALPHA = ("R", "G", "B"), "A"


def load_opencv(purpose: str, extra: str) -> Any:
    """The module cv2, or an error that says what for and which extra brings it."""
    return load_extra("cv2", f"{purpose} needs OpenCV", extra)


def load_extra(module: str, message: str, extra: str) -> Any:
    """An optional module, or an error that says what needs it and which extra brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        hint = f'install the extra: pip install "lightmatrix[{extra}]"'
        raise MissingExtraError(message, hint=hint) from error


def read_exr(file: Path) -> NDArray[Any]:
    """Read an unreduced one-part float picture: (rows, cols[, 2 to 4]) float16 or float32."""
    library = load_extra("OpenEXR", "EXR files need the OpenEXR library", "exr")
    with library.File(str(file), header_only=True) as opened:
        if len(opened.parts) != 1:
            hint = "save one image a file"
            raise InputError(f"{file}: holds {len(opened.parts)} parts", hint=hint)
        header = opened.header()
        names = _channel_order(file, [str(channel.name) for channel in header["channels"]])
        first, last = header["dataWindow"]
        cols, rows = (int(n) for n in last - first + 1)
        if any((a != b).any() for a, b in zip((first, last), header["displayWindow"], strict=True)):
            raise InputError(
                f"{file}: stores only a part of its picture, or more than it",
                hint="save it with a data window that is the display window",
            )
        check_image_size(file, (rows, cols, len(names)))
    with library.File(str(file), separate_channels=True) as opened:
        pixels = [np.array(opened.channels()[name].pixels) for name in names]
    if any(values.shape != (rows, cols) or values.dtype.kind != "f" for values in pixels):
        hint = "save all channels as half or float, none of them reduced"
        raise InputError(f"{file}: has channels of several kinds", hint=hint)
    return pixels[0] if len(pixels) == 1 else np.stack(pixels, axis=-1)


def write_exr(file: Path, pixels: NDArray[np.float32], names: Sequence[str] | None = None) -> None:
    """Write an image, (rows, cols) or (rows, cols, 3 or 4), as 32-bit float without loss.

    With `names`, one for each channel, an image may have any number of them.
    """
    library = load_extra("OpenEXR", "EXR files need the OpenEXR library", "exr")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    usual = ("Y",) if pixels.ndim == 2 else (*_EXR_COLOURS, _EXR_ALPHA)[: pixels.shape[2]]
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    channels = {
        name: np.ascontiguousarray(planes[..., k], np.float32)
        for k, name in enumerate(names or usual)
    }
    with library.File(header, channels) as made:
        made.write(str(file))


def _channel_order(file: Path, names: list[str]) -> list[str]:
    """The channels of a file in the order of an image."""
    colours = [name for name in names if name != _EXR_ALPHA]
    alpha = [_EXR_ALPHA] if _EXR_ALPHA in names else []
    if sorted(colours) == sorted(_EXR_COLOURS):
        return [*_EXR_COLOURS, *alpha]
    if len(colours) == 1:
        return [*colours, *alpha]
    hint = "save it in grey or RGB"
    raise InputError(f"{file}: has the channels {', '.join(names[:8])}", hint=hint)


def read_raw(file: Path, *, mosaic: bool = False) -> NDArray[np.float32]:
    """Read a raw file as the sensor lies: (rows, cols) behind a colour filter, or (rows, cols, 3).

    Noise may be below 0. Missing colours are interpolated linearly, so that light still adds up.
    """
    library = load_extra("rawpy", "raw camera files need LibRaw", "raw")
    with library.imread(str(file)) as opened:
        rows, cols = opened.sizes.height, opened.sizes.width
        check_image_size(file, (rows, cols, 3))
        flat = opened.raw_type == library.RawType.Flat
        if mosaic and not flat:
            hint = "leave the option mosaic out"
            raise InputError(f"{file}: holds colours already, no mosaic", hint=hint)
        black, clip = _levels(file, opened)
        if mosaic:
            colour = np.asarray(opened.raw_colors_visible)
            levels = np.asarray(opened.raw_image_visible, np.float32)
            return ((levels - black[colour]) / (clip - black)[colour]).astype(np.float32)
        span = clip - black
        if flat:
            black, span = _with_one_black(opened, black, span)
        levels = opened.postprocess(
            demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,
            output_color=library.ColorSpace.raw,
            highlight_mode=library.HighlightMode.Clip,
            user_wb=[1, 1, 1, 1],
            gamma=(1, 1),
            output_bps=16,
            no_auto_bright=True,
            no_auto_scale=True,
            # Black is subtracted below: LibRaw would cut off noise that is darker than black.
            user_black=0,
            user_cblack=[0, 0, 0, 0],
            user_flip=0,
        )
        return ((levels - black[:3]) / span[:3]).astype(np.float32)


def _with_one_black(
    opened: Any, black: NDArray[np.float32], span: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Give all colours the least black level, since both greens become one; levels and spans."""
    colour = np.asarray(opened.raw_colors_visible)
    colours = np.unique(colour)
    least = black[colours].min()
    above = np.maximum(black - least, 0).astype(np.uint16)
    if above[colours].any():
        levels = opened.raw_image_visible
        levels -= np.minimum(levels, above[colour])
    if 3 in colours:
        span = np.where([False, True, False, True], span[[1, 3]].min(), span)
    return np.full(4, least, np.float32), span


def _levels(file: Path, opened: Any) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Black and clip level of the filter's four colours; the fourth is the second green."""
    black = np.array(opened.black_level_per_channel, np.float32)
    clip = np.full(4, opened.white_level, np.float32)
    # Some cameras say where the sensor clips, if that is before the file's range ends.
    camera_clip = opened.camera_white_level_per_channel
    if camera_clip is not None and min(camera_clip) > 0:
        clip = np.minimum(clip, np.array(camera_clip, np.float32))
    if not (clip > black).all():
        raise InputError(
            f"{file}: says that it is black at {black.max():g} and white at {clip.min():g}",
            hint="convert it to DNG or TIFF by the camera's own program",
        )
    return black, clip


def orientation(path: str | Path) -> int:
    """How viewers turn a photograph, by its EXIF tag, which is not followed here; 1 is not at all.

    A camera that writes the tag into some frames only would move these against the others.
    """
    try:
        return int(_exif(path).get(ExifTags.Base.Orientation, 1))
    # Image libraries raise nearly anything on damaged files.
    except Exception:
        return 1


# Where Pillow finds the orientation of a PNG: chunks of EXIF, as bytes or text, and of XMP.
_PNG_TAGS = re.compile(rb"eXIf|Raw profile type exif|XML:com\.adobe\.xmp")


def _exif(path: str | Path) -> Image.Exif:
    with warnings.catch_warnings():
        # Pillow warns of unusual tags, which are of no interest here.
        warnings.simplefilter("ignore")
        with Image.open(path) as image:
            # A PNG may hold tags behind its pixels, which Pillow would decode to look for them.
            if image.format == "PNG" and not _PNG_TAGS.search(Path(path).read_bytes()):
                return Image.Exif()
            tags = image.getexif()
            # Pillow reads this part on request, while the file is open, and keeps it.
            tags.get_ifd(ExifTags.IFD.Exif)
            return tags


def upright(path: str | Path, image: NDArray[Any]) -> NDArray[Any]:
    """A picture, (rows, cols[, channels]), turned and mirrored as viewers show it."""
    turned = {2: image[:, ::-1], 3: image[::-1, ::-1], 4: image[::-1]}
    across = image.swapaxes(0, 1)
    turned |= {5: across, 6: across[:, ::-1], 7: across[::-1, ::-1], 8: across[::-1]}
    return turned.get(orientation(path), image)


def video_frames(path: str | Path) -> Iterator[NDArray[np.uint8]]:
    """The frames of a video file as a display shows them, (rows, cols, 3), 0 to 255, by FFmpeg.

    An InputError says that it is none.
    """
    with _video(path) as opened:
        for frame in opened.decode(video=0):
            yield frame.to_ndarray(format="rgb24")


def video_rate(path: str | Path) -> float:
    """Frames of a video file in a second; 25 if it does not say."""
    with _video(path) as opened:
        return float(opened.streams.video[0].average_rate or 25)


@contextmanager
def _video(path: str | Path) -> Iterator[Any]:
    library = load_extra("av", "video files need PyAV", "video")
    try:
        with library.open(str(path)) as opened:
            yield opened
    except (OSError, ValueError, IndexError) as error:
        hint = "export it again, such as to .mp4"
        raise InputError(f"{path}: cannot be read as a video ({error})", hint=hint) from error


def exposure_time(path: str | Path) -> float | None:
    """Exposure time of a photograph in seconds; None if it does not say, or is damaged."""
    file = Path(path)
    try:
        if file.suffix.lower() in RAW:
            library = load_extra("rawpy", "raw camera files need LibRaw", "raw")
            with library.imread(str(file)) as opened:
                seconds = float(opened.other.shutter_speed)
        else:
            tags = _exif(file).get_ifd(ExifTags.IFD.Exif)
            seconds = float(tags.get(ExifTags.Base.ExposureTime) or 0)
    except MissingExtraError:
        raise
    # Image libraries raise nearly anything on damaged files.
    except Exception:
        return None
    # A longer exposure than a day is a damaged tag.
    return seconds if 0 < seconds < 86_400 else None
