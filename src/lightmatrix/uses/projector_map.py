"""Where the light of each projector pixel goes, for programs that map pictures onto a scene."""

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lightmatrix.errors import InputError, OutputError
from lightmatrix.files import kinds
from lightmatrix.files.extras import write_exr
from lightmatrix.files.images import fill_image
from lightmatrix.files.writing import atomic_file, atomic_files, atomic_folder, check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.paths import as_path
from lightmatrix.reprs import ShortRepr
from lightmatrix.transport.correspondence import REACH, Correspondence, pixel_rows, strongest_places
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.transport.sparse_rows import footprint_sizes
from lightmatrix.uses.compensation import compensate, joint_light
from lightmatrix.uses.loading import Transport, loaded


@dataclass(frozen=True, eq=False, repr=False)
class ProjectorMap(ShortRepr):
    """The camera place that receives most of each projector pixel's light; by `map_projector`.

    Parameters
    ----------
    place : (rows, cols, 2) float32
        Row and column of the camera for each projector pixel, to fractions of a pixel, where 0 is
        the middle of the first; NaN where the camera sees nothing of it.
    weight : (rows, cols) float32
        The light that arrives there, in units of the clip level.
    confidence : (rows, cols) float32
        Its share of all light of the projector pixel that the camera sees, in [0, 1].
    source_shape : (rows, cols)
        The camera's pixels.
    reverse : ProjectorMap, optional
        The same for camera pixels: the projector place of which each sees most light.
    blend : (rows, cols) float32, optional
        Of several projectors: the light of each pixel, in [0, 1], by which all together show an
        even white.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.map_projector(lm.truth("metal").transport())
    >>> [round(float(place), 1) for place in found.place[20, 30]], found.reverse.place.shape
    ([19.9, 30.2], (64, 64, 2))
    """

    place: NDArray[np.float32]
    weight: NDArray[np.float32]
    confidence: NDArray[np.float32]
    source_shape: tuple[int, int]
    reverse: "ProjectorMap | None" = None
    blend: NDArray[np.float32] | None = None

    @property
    def known(self) -> NDArray[np.bool_]:
        """The pixels that have a place, (rows, cols)."""
        return np.isfinite(self.place[..., 0])

    @property
    def uv(self) -> NDArray[np.float32]:
        """The places as texture coordinates (u, v), (rows, cols, 2).

        (0, 0) is the lower left corner of the camera's picture, and (1, 1) its upper right one.
        """
        rows, cols = self.source_shape
        row, col = np.moveaxis(self.place, -1, 0)
        return np.stack([(col + 0.5) / cols, 1 - (row + 0.5) / rows], axis=-1).astype(np.float32)

    def save(
        self,
        path: str | Path,
        *,
        geometry: RigGeometry | str | Path | None = None,
        overwrite: bool = False,
    ) -> None:
        """Write the map for another program; the ending says for which.

        Pictures that are mapped have the camera's view: what lies at a place in them is shown by
        the projector pixels that light this place.

        Parameters
        ----------
        path : str or Path
            .mpcdi: MPCDI 2.0, profile 2d. .exr: an STMap, u and v in red and green, known pixels in
            alpha. .png: NAME-x.png and NAME-y.png, from 0, the left or upper edge, to 65535, the
            other one; 0 where unknown. .npz: map_x and map_y as OpenCV's `remap` takes them, -1
            where unknown, weight and confidence. A name without ending: the folder that LightLeaks
            reads, with proMap.png and proConfidence.exr.
        geometry : RigGeometry, str or Path, optional
            Where camera and projector stand; the folder then has points of the surface, in the unit
            of the geometry, as xyzMap.exr.
        overwrite : bool
            Whether an existing map may be replaced.

        Raises
        ------
        OutputError
            On another ending, or if a file exists or cannot be written.
        InputError
            On a geometry of another rig, or for a file, none of which hold points.
        """
        output = as_path(path)
        suffix = output.suffix.lower()
        files = map_files(output, points=geometry is not None)
        if not suffix:
            if isinstance(geometry, str | Path):
                geometry = RigGeometry.load(geometry)
            if geometry is not None and geometry.camera_shape != self.source_shape:
                raise InputError(
                    f"a geometry of a camera of {geometry.camera_shape[0]} x "
                    f"{geometry.camera_shape[1]}, for a map of {self.source_shape[0]} x "
                    f"{self.source_shape[1]}",
                    hint="give the geometry of this rig, scaled to T's pixels",
                )
            with atomic_folder(output, kinds.MAP_FOLDER, overwrite=overwrite) as folder:
                self._fill_folder(folder, geometry)
            return
        with atomic_files(files, overwrite=overwrite) as parts:
            for place, part in zip(files, parts, strict=True):
                _WRITERS[suffix](self, part, place)

    def _fill_folder(self, folder: Path, geometry: RigGeometry | None) -> None:
        """What the programs of the artwork Light Leaks by McDonald and Jørgensen read."""
        pixels = np.zeros((*self.weight.shape, 3), np.uint16)
        # Camera column and row.
        pixels[..., :2] = np.rint(np.nan_to_num(self.place[..., ::-1])).clip(0, 65535)
        fill_image(folder / "proMap.png", pixels)
        fill_image(folder / "proConfidence.exr", np.where(self.known, self.confidence, 0))
        if geometry is not None:
            points = np.zeros((*self.weight.shape, 3), np.float32)
            own = np.argwhere(self.known)
            found = geometry.triangulate(
                self.place[self.known][:, ::-1], geometry.projector_places(own[:, ::-1])
            )
            points[self.known] = np.nan_to_num(found)
            fill_image(folder / "xyzMap.exr", points)


def _write_uv(found: ProjectorMap, part: Path, _: Path) -> None:
    uv, known = np.nan_to_num(found.uv), found.known[..., None]
    write_exr(part, np.concatenate([uv, np.zeros_like(known, np.float32), known], axis=-1))


def _write_axis(found: ProjectorMap, part: Path, place: Path) -> None:
    """A 16-bit PNG of the columns if its name ends in -x, else of the rows."""
    axis = 1 if place.stem.endswith("-x") else 0
    share = (found.place[..., axis] + 0.5) / found.source_shape[axis]
    levels = np.rint(65535 * np.nan_to_num(share)).clip(1, 65535)
    fill_image(part, np.where(found.known, levels, 0).astype(np.uint16))


def _write_remap(found: ProjectorMap, part: Path, _: Path) -> None:
    row, col = np.moveaxis(np.nan_to_num(found.place, nan=-1.0), -1, 0)
    arrays: dict[str, Any] = {
        # First, because it tells that the file is ours.
        kinds.NUMBERS_MARK: np.array(found.source_shape),
        "map_x": col,
        "map_y": row,
        "weight": found.weight,
        "confidence": found.confidence,
    }
    with part.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


# MPCDI 2.0 (VESA 2015), profile "2d": a warp for each pixel, alpha, and beta. The gamma is that of
# the pictures that media servers show, and of most projectors.
_MPCDI = """<?xml version="1.0" encoding="utf-8"?>
<MPCDI profile="2d" geometry="2" color="2" date="{date:%Y-%m-%d %H:%M:%S}" version="2.0">
  <display>{buffers}
  </display>
  <files>{files}
  </files>
</MPCDI>
"""
_BUFFER = """
    <buffer id="lightmatrix{n}" xResolution="{cols}" yResolution="{rows}">
      <region id="projector{n}" x="0" y="0" xSize="1" ySize="1"
              xResolution="{cols}" yResolution="{rows}">
        <color><decode type="gamma" gamma="2.2"/><encode type="gamma" gamma="2.2"/></color>
      </region>
    </buffer>"""
_FILES = """
    <fileset region="projector{n}">
      <geometryWarpFile>
        <path>{warp}</path><interpolation>linear</interpolation>
      </geometryWarpFile>
      <alphaMap>
        <bitDepth>{depth}</bitDepth><componentDepth>1</componentDepth>
        <gammaEmbedded>1.0</gammaEmbedded><path>alpha{n}.png</path>
      </alphaMap>
      <betaMap>
        <bitDepth>8</bitDepth><componentDepth>1</componentDepth><path>beta{n}.png</path>
      </betaMap>
    </fileset>"""


def _write_regions(several: Sequence[ProjectorMap], part: Path) -> None:
    buffers, files = [], []
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, found in enumerate(several):
            n = f"-{number + 1}" if number else ""
            rows, cols = found.weight.shape
            # The third component is an error, which is not known, or 1 where the place is unknown.
            error = np.where(found.known, np.nan, 1)[..., None]
            warp = np.concatenate([found.uv, error], axis=-1).astype("<f4")
            # The mask of one projector has 8 bits; steps of a blend must not be seen.
            depth, blend = (8, 1.0) if found.blend is None else (16, found.blend)
            alpha = np.rint((2**depth - 1) * np.where(found.known, blend, 0))
            # First, because it tells that the file is ours. PFM begins with the bottom row.
            header = f"PF\n{cols} {rows}\n-1.0\n".encode()
            name = kinds.MPCDI_MARK.replace(".", f"{n}.")
            archive.writestr(name, header + warp[::-1].tobytes())
            beta = np.zeros((rows, cols), np.uint8)
            for word, image in (("alpha", alpha.astype(f"u{depth // 8}")), ("beta", beta)):
                archive.writestr(f"{word}{n}.png", imagecodecs.png_encode(image))
            buffers.append(_BUFFER.format(n=n, rows=rows, cols=cols))
            files.append(_FILES.format(n=n, warp=name, depth=depth))
        both = {"buffers": "".join(buffers), "files": "".join(files)}
        archive.writestr("mpcdi.xml", _MPCDI.format(date=datetime.now(UTC), **both))


_WRITERS: Mapping[str, Callable[[ProjectorMap, Path, Path], None]] = {
    ".mpcdi": lambda found, part, _: _write_regions([found], part),
    ".exr": _write_uv,
    ".png": _write_axis,
    ".npz": _write_remap,
}


def map_files(path: str | Path, *, points: bool) -> dict[Path, kinds.OutputKind]:
    """The files or the folder that a map is written to, with their kinds; only that has points."""
    output = as_path(path)
    suffix = output.suffix.lower()
    if points and suffix:
        hint = "leave the geometry out, or the ending: the folder for LightLeaks has xyzMap.exr"
        raise InputError(f"a geometry for {output}, which holds no points", hint=hint)
    if suffix == ".png":
        pair = (output.with_name(f"{output.stem}-{axis}{output.suffix}") for axis in "xy")
        return dict.fromkeys(pair, kinds.PICTURE)
    known = {".mpcdi": kinds.MPCDI, ".exr": kinds.IMAGE, ".npz": kinds.NUMBERS}
    if suffix and suffix not in known:
        hint = f"end it in {', '.join(_WRITERS)}, or in nothing for a folder"
        raise OutputError(f"{output}: no map ends in {suffix}", hint=hint)
    return {output: known[suffix] if suffix else kinds.MAP_FOLDER}


def map_projector(
    transport: Transport,
    *,
    geometry: RigGeometry | str | Path | None = None,
    reverse: bool = False,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> ProjectorMap:
    """Find the camera place that receives most of the light of each projector pixel.

    Codes of stripes say which projector pixel a camera pixel sees, if it sees one. A column of T
    says where all light of a projector pixel arrives, also by mirrors, through glass and in corners
    where camera pixels see the light of several projector pixels.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path
        T, or where `open` finds it; the channels of a colour camera are added.
    geometry : RigGeometry, str or Path, optional
        Where camera and projector stand, for files that hold points; see `ProjectorMap.save`.
    reverse : bool
        Whether the file holds the map of camera pixels to the projector instead.
    output : str or Path, optional
        File or folder to write; see `ProjectorMap.save`.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    ProjectorMap
        Its `reverse` is the map of camera pixels to the projector.

    Raises
    ------
    InputError
        If T is no matrix, or a store that does not fit into memory.
    OutputError
        If the map cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> found = lm.map_projector(lm.truth("l_objects").transport(), output="wall.mpcdi")
    >>> bool(found.known.mean() > 0.8)
    True
    """
    if output is not None:
        for place, kind in map_files(output, points=geometry is not None).items():
            check_output(place, kind, overwrite=overwrite)
    # The columns are a second copy of the matrix.
    found = _mapped(loaded(transport, 2.5))
    if output is not None:
        written = found.reverse if reverse and found.reverse else found
        written.save(output, geometry=geometry, overwrite=overwrite)
    return found


def map_projectors(
    transport: Transport | Sequence[Transport],
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> tuple[ProjectorMap, ...]:
    """Map several projectors that light one scene together, with masks that blend them.

    Parameters
    ----------
    transport : LightTransport, StoredTransport, str or Path, or several of them
        T of each projector, as in `compensate`; such as the folder that `estimate` wrote.
    output : str or Path, optional
        MPCDI file with a region for each, see `ProjectorMap.save`; alpha holds the `blend`.
    overwrite : bool
        Whether an existing file may be replaced.

    Returns
    -------
    tuple of ProjectorMap

    Raises
    ------
    InputError
        As `compensate`.
    OutputError
        On another ending than .mpcdi, or if the file exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> one = lm.truth("metal").transport()
    >>> [found.blend.shape for found in lm.map_projectors([one, one])]
    [(64, 64), (64, 64)]
    """
    if output is not None:
        if as_path(output).suffix.lower() != ".mpcdi":
            hint = "end it in .mpcdi, or map the store of each projector"
            raise OutputError(f"{output}: only .mpcdi holds several projectors", hint=hint)
        check_output(output, kinds.MPCDI, overwrite=overwrite)
    light = joint_light(transport)
    white = compensate(light.matrices, np.ones(light.camera_shape, np.float32))
    pairs = zip(light.matrices, white.patterns, strict=True)
    several = tuple(replace(_mapped(matrix), blend=pattern) for matrix, pattern in pairs)
    if output is not None:
        with atomic_file(output, kinds.MPCDI, overwrite=overwrite) as part:
            _write_regions(several, part)
    return several


def _mapped(matrix: LightTransport) -> ProjectorMap:
    camera, projector = (matrix.camera_shape[0], matrix.camera_shape[1]), matrix.projector_shape
    rows, behind = pixel_rows(matrix)
    columns = csr_array(rows.T)
    columns.sort_indices()
    light = np.asarray(matrix.background.sum(axis=0, dtype=np.float64) @ matrix.pooling)
    # A camera with finer pixels than the projector sees larger spots. The window holds all of one,
    # wherever in it the strongest pixel lies.
    sizes = footprint_sizes(columns)
    reach = max(REACH, int(np.ceil(np.sqrt(np.median(sizes[sizes > 0]))))) if sizes.any() else REACH
    return _as_map(
        strongest_places(columns, light, projector, camera, reach),
        _as_map(strongest_places(rows, behind, camera, projector)),
    )


def _as_map(found: Correspondence, reverse: ProjectorMap | None = None) -> ProjectorMap:
    light, other = found.light, found.projector_shape
    assert light is not None
    assert other is not None
    # Below this share of a bright pixel's light, what an estimate shows are its errors.
    dark = light <= 0.02 * np.quantile(light, 0.9)
    place = np.where(dark[..., None], np.float32(np.nan), found.place)
    return ProjectorMap(place, light, found.confidence, other, reverse)
