"""`lm.project`: shows a picture, a folder of pictures or a video on a projector."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.defaults import VIDEOS
from lightmatrix.errors import DeviceError, InputError
from lightmatrix.files.extras import video_frames, video_rate
from lightmatrix.files.images import DISPLAY_GAMMA, given_image, read_light, write_image
from lightmatrix.files.kinds import IMAGE
from lightmatrix.files.stacks import list_images
from lightmatrix.files.writing import check_output
from lightmatrix.patterns.pattern_set import to_grey
from lightmatrix.patterns.projector_curve import ProjectorResponse
from lightmatrix.ranges import check_number, check_whole
from lightmatrix.rig.devices.base import Clock, Projector, size_in_words
from lightmatrix.rig.devices.several import pattern_sizes, stacked
from lightmatrix.rig.photograph import Photographer, find_white_and_black, take_average
from lightmatrix.rig.rig import Rig, on_screen
from lightmatrix.rig.rig_measurements import measure_rig


def project(
    device: Rig | Projector,
    source: NDArray[Any] | str | Path | list[str | Path] | list[Path],
    *,
    seconds: float | None = None,
    fps: float | None = None,
    cell: int = 1,
    projector_response: ProjectorResponse | str | Path | None = None,
    until: Callable[[], bool] | None = None,
    photograph: str | Path | None = None,
    keep: str | Path | None = None,
    overwrite: bool = False,
) -> NDArray[np.float32] | None:
    """Show a picture, a folder of pictures, or a video, pixel by pixel.

    Pictures are never scaled, since that would undo a compensation. A smaller one is shown in the
    middle of a black screen.

    Parameters
    ----------
    device : Rig or Projector
        See `open_rig` and `open_projector`.
    source : array, str or Path
        (rows, cols[, 3]) in [0, 1], an image file, a folder of images in natural order, or a video
        file. Folders and videos begin anew at their end. Of several projectors, a list of a picture
        for each, or pictures that hold those of all, one above the other.
    seconds : float, optional
        How long, above 0. None: until a key is pressed in the projector's window, or `until`.
    fps : float, optional
        Pictures of a folder or a video each second. None: 25, or as the video says.
    cell : int
        Projector pixels along a side of each pixel, if T was measured so.
    projector_response : ProjectorResponse, str or Path, optional
        What grey values are in light, if the pictures hold light; see `compensate`. None: they hold
        grey values, as those that `compensate` writes.
    until : callable, optional
        Called after each picture; True ends.
    photograph : str or Path, optional
        Image file for what a rig's camera sees of the first picture, after which it ends: the light
        above a black picture, where 1 is a bright place under white.
    keep : str or Path, optional
        File of the rig's measurements, for the photograph; see `measure_rig`.
    overwrite : bool
        Whether an existing photograph may be replaced.

    Returns
    -------
    camera_shape float32, optional
        The photograph, in linear light.

    Raises
    ------
    InputError
        On a picture that is larger than the projector, an empty folder, numbers out of range, or a
        photograph without a camera.
    DeviceError
        If a device is lost.
    OutputError
        If the photograph cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> with lm.open_rig("virtual:metal,real=0") as rig:
    ...     seen = lm.project(rig, np.eye(64), photograph="seen.png")
    >>> seen.shape
    (64, 64)
    """
    check_whole("projector pixels along a side", cell, hint="use at least 1")
    for what, number, hint in (("a time", seconds, "10"), ("pictures a second", fps, "25")):
        if number is not None:
            check_number(what, number, most=1e6, above=True, hint=f"use a number such as {hint}")
    rig = device if isinstance(device, Rig) else None
    projector = device.projector if isinstance(device, Rig) else device
    clock = rig.clock if rig is not None else Clock()
    curve = projector_response
    if isinstance(curve, str | Path):
        curve = ProjectorResponse.parse(curve)
    several, screen = pattern_sizes(projector, cell), projector.shape
    if isinstance(source, list):
        lights = [given_image("a picture", one, read_light) for one in source]
        source = stacked(lights, several or [lights[0].shape[:2]])
    pictures, rate = _pictures(source)

    def on_all(picture: NDArray[Any]) -> NDArray[np.uint8]:
        """A picture as grey values, in the middle of a black screen.

        That of several projectors must hold the pictures of all.
        """
        if several and [cell * side for side in picture.shape[:2]] != list(screen):
            stacked([picture], several)
        grey = to_grey(np.clip(picture, 0, 1)) if curve is None else curve.grey_for(picture)
        size = (cell * grey.shape[0], cell * grey.shape[1])
        if size[0] > screen[0] or size[1] > screen[1]:
            what = f"a picture of {size_in_words(size)} pixels"
            hint = "make one of the projector's size, such as by `compensate`"
            raise InputError(f"{what}, for a projector of {size_in_words(screen)}", hint=hint)
        return on_screen(grey, screen, cell)

    shown = map(on_all, pictures)
    if photograph is not None:
        check_output(photograph, IMAGE, overwrite=overwrite)
        if rig is None:
            raise InputError("a photograph without a camera", hint="give a rig: see open_rig")
        return _photographed(rig, next(shown), photograph, keep, overwrite)
    start = clock.now()
    for number, image in enumerate(shown, start=1):
        try:
            projector.show(image)
        except DeviceError:
            # The Escape key closes a window.
            if not projector.asked_to_end():
                raise
            break
        # A single picture comes again and again, so that keys are looked for.
        clock.sleep(start + number / (fps or rate) - clock.now())
        over = seconds is not None and clock.now() - start >= seconds
        if over or projector.asked_to_end() or (until is not None and until()):
            break
    return None


def _pictures(source: NDArray[Any] | str | Path) -> tuple[Iterator[NDArray[Any]], float]:
    """The pictures of a source without end, in [0, 1], and how many a second."""
    if not isinstance(source, str | Path) or Path(source).suffix.lower() not in VIDEOS:
        folder = isinstance(source, str | Path) and Path(source).is_dir()
        files: list[Any] = list(list_images(source)) if folder else [source]  # type: ignore[arg-type]
        read = (given_image("a picture", one, read_light) for one in itertools.cycle(files))
        return (itertools.repeat(next(read)) if len(files) == 1 else read), 25.0
    films = map(video_frames, itertools.repeat(source))
    frames = itertools.chain.from_iterable(films)
    return (frame / np.float32(255) for frame in frames), video_rate(source)


def _photographed(
    rig: Rig, image: NDArray[np.uint8], path: str | Path, keep: str | Path | None, overwrite: bool
) -> NDArray[np.float32]:
    settle = measure_rig(rig, ["settle"], keep=keep).settle
    assert settle is not None
    photographer = Photographer(rig, settle.seconds)
    whites = rig.persistently(lambda: find_white_and_black(photographer))
    frame = rig.persistently(lambda: take_average(photographer, image, whites.exposure))
    bright = float(np.quantile(whites.light, 0.99))
    light = ((frame.mean - whites.black.mean) / bright).astype(np.float32)
    png = Path(path).suffix.lower() == ".png"
    write_image(
        path, np.clip(light, 0, 1) ** (1 / DISPLAY_GAMMA) if png else light, overwrite=overwrite
    )
    return light
