"""Projection mapping: maps of projector pixels, a picture on a pile of blocks, two projectors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from skimage import data

from experiments.harness import Experiment, Measured, Row, means
from lightmatrix.estimators.estimate import estimate
from lightmatrix.files.images import fitted, write_image
from lightmatrix.judgement.metrics import relative_error
from lightmatrix.patterns.making import make_patterns
from lightmatrix.pictures.maps import display
from lightmatrix.pictures.style import figure, save
from lightmatrix.planning.plan import plan
from lightmatrix.rig.capturing import CaptureSettings, take_capture
from lightmatrix.rig.rig import open_rig
from lightmatrix.shape.decode import decode
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import Truth
from lightmatrix.transport.correspondence import Correspondence
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.uses.compensation import Compensation, Compensator, compensate, compensator
from lightmatrix.uses.projector_map import map_projector
from lightmatrix.uses.wanted import wanted_samples

NOISE = 0.003
# The columns of the simulated projector that each of two projectors has.
LEFT, RIGHT = slice(0, 42), slice(22, 64)
# A projector pixel is lit if more than this share of a bright pixel's light arrives at one place.
# Its map is right if the place found is less than a camera pixel away from that of the true T.
_LIT, _RIGHT = 0.1, 1.0


@dataclass(frozen=True)
class Case:
    """A kind of measurement, of a scene, with a seed."""

    kind: str
    scene: str
    side: int
    seed: int

    @property
    def name(self) -> str:
        """A file name."""
        return f"{self.kind}-{self.scene}-{self.side}-s{self.seed}"


def cases(quick: bool) -> Iterator[Case]:
    """All cases; a quick run has one seed and bundled scenes."""
    for seed in range(1 if quick else 3):
        for scene in ("corner",) if quick else ("mirror_balls", "metal"):
            yield Case("maps", scene, 64, seed)
        for scene in ("l_objects", "corner") + (() if quick else ("dome", "stage", "statues")):
            yield Case("projectors", scene, 64, seed)
    yield Case("picture", "l_objects", 64 if quick else 128, 0)
    for scene in () if quick else ("dome", "stage", "statues"):
        yield Case("two", scene, 128, 0)


def measure(case: Case) -> Measured:
    """The rows of a case, and the pictures of a photograph on a scene."""
    # The pictures of two projectors hold 1,024 paths a pixel.
    samples = 1024 if case.kind == "two" else None
    truth = library.truth(case.scene, (case.side, case.side), samples=samples)
    kinds = {"maps": _maps, "projectors": _projectors, "picture": _picture, "two": _two}
    measured = kinds[case.kind](truth, case.seed)
    names = {"kind": case.kind, "scene": case.scene, "size": case.side, "seed": case.seed}
    return Measured([{**names, **row} for row in measured.rows], measured.arrays)


def _photographed(truth: Truth, kind: str, count: int | None, seed: int, **options: Any) -> Any:
    exposure = plan(truth, frames=32, noise=NOISE).exposure
    patterns = make_patterns(kind, truth.projector_shape, count, seed=seed)
    return simulate(truth, patterns, exposure=exposure, noise=NOISE, seed=seed, **options)


def _maps(truth: Truth, seed: int) -> Measured:
    """Shares of lit projector pixels whose place is right, by method."""
    known = map_projector(truth.transport())
    lit = known.weight > _LIT * np.quantile(known.weight, 0.9)

    def right(place: NDArray[np.floating]) -> float:
        away = np.linalg.norm(place - known.place, axis=-1)
        return float((away[lit] < _RIGHT).mean())

    places: dict[str, NDArray[Any]] = {}
    for count in (32, 64, 128):
        found = estimate(_photographed(truth, "bernoulli", count, seed), check=False)
        places[f"T, {count} photographs"] = map_projector(found).place
    for code in ("graycode", "phase", "microphase"):
        seen = decode(_photographed(truth, code, None, seed))
        places[f"{code}, {_count(truth, code)} photographs"] = _inverted(seen, truth)
    return Measured([{"method": name, "right": right(place)} for name, place in places.items()])


def _count(truth: Truth, code: str) -> int:
    return make_patterns(code, truth.projector_shape).count


def _inverted(seen: Correspondence, truth: Truth) -> NDArray[np.float64]:
    """The camera pixel that sees each projector pixel best: the nearest within a pixel."""
    known = seen.valid & np.isfinite(seen.place).all(axis=-1)
    pixels = np.moveaxis(np.indices(truth.projector_shape), 0, -1)
    away, nearest = cKDTree(seen.place[known]).query(pixels)
    place = np.argwhere(known)[nearest].astype(np.float64)
    place[away > 1] = np.nan
    return place


def _psnr(photograph: NDArray[np.floating], found: Compensation, counted: Any) -> float:
    """The PSNR of a photograph at its best brightness, so that only its looks count."""
    seen, target = photograph.ravel()[counted], found.target.ravel()[counted]
    missed = (seen * (seen @ target) / (seen @ seen) - target) / found.scale
    return float(-10 * np.log10(np.mean(missed**2)))


def _plain(shared: Compensator, wanted: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """The picture as it is: each projector pixel shows what the camera pixels want that it lights.

    With two projectors, both show it where they land.
    """
    weight = shared.light.adjoint(shared.lit.astype(np.float32))
    light = shared.light.adjoint(shared.lit * wanted)
    shown = np.divide(light, weight, out=np.zeros_like(light), where=weight > 0)
    return np.clip(scale * shown, 0, 1)


def _projectors(truth: Truth, seed: int) -> Measured:
    """Two projectors that overlap by a third, measured at once by one set of random patterns."""
    both = truth if "projectors" in truth.metadata else _two_of_one(truth)
    known, shape = both.transport().split(), both.camera_shape
    rows: list[Row] = []

    def add(method: str, found: Sequence[LightTransport]) -> None:
        for k, (one, right) in enumerate(zip(found, known, strict=True), start=1):
            error = relative_error(one, right)
            rows.append({"method": f"{method}, projector {k}", "error": error})

    truths = [
        Truth(one.sparse, np.zeros_like(one.sparse.data), shape, one.projector_shape)
        for one in known
    ]
    add("alone, 32", [estimate(_photographed(one, "bernoulli", 32, seed)) for one in truths])
    joint: dict[int, LightTransport] = {}
    for count in (32, 40, 48):
        joint[count] = estimate(_photographed(both, "bernoulli", count, seed))
        add(f"at once, {count}", joint[count].split())
    # All light of one wide projector moves alike from camera pixel to camera pixel.
    as_one = replace(_photographed(both, "bernoulli", 32, seed), projectors=())
    found_as_one = replace(estimate(as_one), provenance=both.metadata)
    add("at once, as one projector, 32", found_as_one.split())
    shared, light = compensator(joint[40]), compensator(known).light
    whites = [one.relight(np.ones(one.projector_shape)) for one in known]
    pictures = {"white": np.ones(shape, np.float32), "picture": _wanted(both)}
    for name, wanted in pictures.items():
        # White that both projectors can give everywhere.
        found = compensate(joint[40], wanted, brightness=0.5 if name == "white" else None)
        counted = found.reachable.ravel()
        ways = {
            "as it is": _plain(shared, wanted.ravel(), found.brightness),
            "gains": np.clip(shared.start(found.target.ravel()), 0, 1),
            "compensated": np.concatenate([pattern.ravel() for pattern in found.patterns]),
        }
        # What a photograph misses is asked for in addition, as in closed loop.
        target, photograph = found.target.ravel(), light.forward(ways["compensated"])
        noise = np.random.default_rng(seed).normal(0, NOISE, target.shape)
        # Its exposure leaves room for twice the target.
        missed = target - photograph - 2 * target.max() * noise
        asked = (target + np.where(counted, missed, 0)).astype(np.float32)
        refined = shared.reaching(target, found.brightness, start=ways["compensated"], asked=asked)
        ways["refined"] = np.concatenate([pattern.ravel() for pattern in refined.patterns])
        for way, pattern in ways.items():
            seen = light.forward(pattern)
            row: Row = {"method": f"{name}, {way}", "PSNR": _psnr(seen, found, counted)}
            if name == "white":
                row["uniform"] = float(np.std(seen[counted]) / np.mean(seen[counted]))
                row["seam"] = _seam(seen.reshape(shape), found.reachable, whites)
            rows.append(row)
    return Measured(rows)


def _two(truth: Truth, seed: int) -> Measured:
    """A photograph that two projectors show, as it is and compensated, where the scene is lit."""
    known, shape = truth.transport(), truth.camera_shape
    measured = estimate(_photographed(truth, "mix", 64, seed), check=False)
    shared = compensator(measured)
    lit = shared.lit.reshape(shape)
    # The rows and the columns of which as much is lit as of most.
    shares = (lit.mean(axis=axis) for axis in (1, 0))
    ends = (np.flatnonzero(share > 0.97 * np.median(share))[[0, -1]] for share in shares)
    box = tuple(slice(first, last + 1) for first, last in ends)
    mask = np.zeros(shape, np.float32)
    mask[box] = 1
    # The head is in the upper part of the picture.
    height, width = mask[box].shape
    light = _luminance()[: round(512 * min(1.0, height / width))]
    wanted = mask.copy()
    wanted[box] = fitted(light, (height, width), "cover")
    found = compensate(measured, wanted, mask=mask)
    counted = found.reachable.ravel()
    ways = {
        "as it is": _plain(shared, wanted.ravel(), found.brightness),
        "compensated": np.concatenate([pattern.ravel() for pattern in found.patterns]),
    }
    seen = {way: known.relight(p.reshape(truth.projector_shape)) for way, p in ways.items()}
    rows = [{"method": way, "PSNR": _psnr(one, found, counted)} for way, one in seen.items()]
    shown = {way.replace(" ", "_"): one[box] / found.scale for way, one in seen.items()}
    return Measured(rows, {"wanted": wanted[box], **shown})


def _two_of_one(whole: Truth) -> Truth:
    """Two projectors, each of which has some columns of one; the right one is upside down."""
    pixels = np.arange(whole.matrix.shape[1]).reshape(whole.projector_shape)
    chosen = [pixels[:, LEFT], pixels[::-1, RIGHT][:, ::-1]]
    # The right one is darker, too.
    brightness = np.repeat([1.0, 0.7], len(pixels))[:, None]
    sizes = {"projectors": [list(each.shape) for each in chosen]}
    return replace(_part(whole, np.vstack(chosen), brightness), metadata=sizes)


def _part(whole: Truth, pixels: NDArray[np.int64], brightness: Any) -> Truth:
    """T of a projector that has some pixels of another one, (rows, cols), darker by column."""
    darker = np.broadcast_to(brightness, pixels.shape).ravel().astype(np.float32)
    parts = (csr_array(part[:, pixels.ravel()]) for part in (whole.matrix, whole.direct))
    matrix, direct = (csr_array(part.multiply(darker[None])) for part in parts)
    # The direct part has the entries of the whole.
    owner = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    direct_data = np.asarray(direct[owner, matrix.indices], np.float32).ravel()
    return Truth(matrix, direct_data, whole.camera_shape, (pixels.shape[0], pixels.shape[1]))


def _seam(
    seen: NDArray[np.float32], reached: NDArray[np.bool_], whites: Sequence[NDArray[np.float32]]
) -> float:
    """Contrast across the borders of the overlap: of two pixels before and behind each."""
    bright = [white > 0.3 * np.quantile(white, 0.9) for white in whites]
    overlap, contrasts = bright[0] & bright[1], []
    for one, other in (bright, bright[::-1]):
        beside = one & ~other & reached & binary_dilation(overlap, iterations=2)
        within = overlap & reached & binary_dilation(one & ~other, iterations=2)
        before, behind = float(seen[beside].mean()), float(seen[within].mean())
        contrasts.append(abs(before - behind) / (before + behind))
    return max(contrasts)


def _luminance() -> NDArray[np.float32]:
    """The luminance of a photograph, in light, (512, 512)."""
    picture = np.asarray(data.astronaut(), np.float32) / 255  # type: ignore[no-untyped-call]
    return (picture**2.2 @ np.array([0.2126, 0.7152, 0.0722], np.float32)).astype(np.float32)


def _wanted(truth: Truth) -> NDArray[np.float32]:
    """The luminance of a photograph, in light, of the camera's size."""
    shape = truth.camera_shape
    return wanted_samples(_luminance(), shape, fit="cover").reshape(shape)


def _picture(truth: Truth, seed: int) -> Measured:
    """A photograph on a scene, by a projector and a webcam of 8 bits that clips, with gammas."""
    size = truth.camera_shape[0]
    webcam = f"size={size},bits=8,black=8,camera_gamma=2.2,real=0,seed={seed}"
    wanted = _wanted(truth)
    with TemporaryDirectory() as folder, open_rig(f"virtual:l_objects,{webcam}") as rig:
        settings = CaptureSettings(response="gamma:2.2")
        capture = take_capture(Path(folder) / "capture", rig, count=64, settings=settings)
        found_transport = estimate(capture)
    known = truth.transport()
    shared = compensator(found_transport)
    found = compensate(found_transport, wanted)
    counted = found.reachable.ravel()
    ways = {
        "as it is": _plain(shared, wanted.ravel(), found.brightness),
        "gains": np.clip(shared.start(found.target.ravel()), 0, 1),
        "compensated": found.pattern.ravel(),
    }
    white = found_transport.relight(np.ones(truth.projector_shape))
    # The unit of T is the exposure that the rig chose.
    unit = float(np.median(white[white > 0]) / np.median(truth.matrix.sum(axis=1)))
    seen = {way: unit * known.relight(p.reshape(truth.projector_shape)) for way, p in ways.items()}
    rows = [{"method": way, "PSNR": _psnr(one, found, counted)} for way, one in seen.items()]
    shown = {way.replace(" ", "_"): image / found.scale for way, image in seen.items()}
    return Measured(rows, {"wanted": wanted, **shown})


def _draw(out: Path, results: list[tuple[Case, Measured]]) -> None:
    """The picture, as it is, and compensated, beside each other."""
    two = [(case.scene, measured.arrays) for case, measured in results if case.kind == "two"]
    if two:
        titles = {"wanted": "the picture", "as_it_is": "two projectors, as it is"}
        titles["compensated"] = "two projectors, compensated"
        with figure(9.6, 2.1 * len(two)) as drawing:
            panels_of = drawing.subplots(len(two), 3, squeeze=False)
            for row, (scene, arrays) in zip(panels_of, two, strict=True):
                for axes, (name, title) in zip(row, titles.items(), strict=True):
                    shown = display(arrays[name], 1.0)
                    axes.imshow(shown, "gray", vmin=0, vmax=1, interpolation="lanczos")
                    axes.set_title(title if scene == two[0][0] else "")
                    axes.set(xticks=[], yticks=[])
                    axes.spines[:].set_visible(False)
                row[0].set_ylabel(scene)
            save(drawing, out, "two-projectors")
    for case, measured in results:
        if case.kind == "picture":
            images = [measured.arrays[name] for name in ("wanted", "as_it_is", "compensated")]
            small = [Image.fromarray(display(one, 1.0).astype(np.float32)) for one in images]
            large = [np.asarray(one.resize((512, 512), Image.Resampling.LANCZOS)) for one in small]
            gap = np.ones((512, 16), np.float32)
            panels = np.hstack([large[0], gap, large[1], gap, large[2]]).clip(0, 1)
            write_image(out / "mapping.png", panels, overwrite=True)


def _summary(rows: list[Row]) -> list[Row]:
    values = ("right", "error", "PSNR", "uniform", "seam")
    filled = [{**dict.fromkeys(values, np.nan), **row} for row in rows]
    return means(filled, ("kind", "scene", "size", "method"), values)


MAPPING = Experiment("mapping", cases, measure, _draw, summary=_summary)
