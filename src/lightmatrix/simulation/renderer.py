"""`lm.render`: the whole light transport matrix of a scene by one pass of path tracing."""

import glob
import importlib.util
import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack

from lightmatrix.errors import InputError, MissingExtraError
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.progress import Progress
from lightmatrix.ranges import check_seed, check_sides
from lightmatrix.resources.memory import available_bytes, check_memory
from lightmatrix.simulation.scenes import Part, Scene, View, seen_by
from lightmatrix.simulation.scenes import scene as find_scene
from lightmatrix.simulation.thinning import joined, thinned_in_steps
from lightmatrix.simulation.truth import Truth, view_geometry
from lightmatrix.transport.matrix import PROJECTORS

# A program that fails or crashes unless the LLVM variant works.
_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import drjit as dr;"
    "assert dr.sum(mi.Float([1, 2]))[0] == 3"
)
# Folders in which Linux distributions and Homebrew install libLLVM.
_FOLDERS = (
    "/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib64", "/opt/homebrew/opt/llvm/lib",
)  # fmt: skip


@cache
def usable_llvm() -> str | None:
    """Path of a libLLVM that works; "" if the renderer has its own; None if there is none."""
    # Mitsuba's fast variants compile through libLLVM. Version 14 is refused, and 15 and 16 abort
    # the whole process. So newer ones are tried in a child process, the newest first.
    versions: dict[str, int] = {}
    for folder in _FOLDERS:
        for path in glob.glob(f"{folder}/libLLVM*"):
            match = re.search(r"libLLVM[-.](?:so\.|dylib\.)?(\d+)", os.path.basename(path))
            if match and int(match[1]) >= 17:
                versions[os.path.realpath(path)] = int(match[1])
    own = os.environ.get("DRJIT_LIBLLVM_PATH")
    for path in [own] if own else [*sorted(versions, key=lambda path: -versions[path]), ""]:
        environment = {**os.environ, "DRJIT_LIBLLVM_PATH": path} if path else dict(os.environ)
        command = [sys.executable, "-c", _PROBE]
        try:
            probe = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=120
            )
        except subprocess.TimeoutExpired:
            continue
        if probe.returncode == 0:
            return path
    return None


def load_mitsuba() -> ModuleType:
    """Mitsuba in its LLVM variant."""
    if importlib.util.find_spec("mitsuba") is None:
        hint = 'install the extra: pip install "lightmatrix[render]"'
        raise MissingExtraError("rendering needs Mitsuba 3, which is not installed", hint=hint)
    llvm = usable_llvm()
    if llvm is None:
        raise MissingExtraError(
            "rendering needs LLVM 17 or newer, and none was found",
            hint="on Debian and Ubuntu: apt-get install libllvm19 (or `make system-deps`); "
            "elsewhere install LLVM, or name its library in DRJIT_LIBLLVM_PATH",
        )
    if llvm:
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba

    mi: Any = mitsuba
    mi.set_variant("llvm_ad_rgb")
    return mi


def mitsuba_scene(
    mi: ModuleType,
    scene: Scene,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    pattern: NDArray[np.float32] | None = None,
    integrator: dict[str, Any] | None = None,
) -> Any:
    """Load a scene; the projector shows `pattern`, (rows, cols) in [0, 1], or white if None."""
    if pattern is None:
        pattern = np.ones(projector_shape, np.float32)
    rows, cols = camera_shape
    intrinsics = scene.camera.intrinsics(camera_shape)
    content: dict[str, Any] = {
        "type": "scene",
        "integrator": integrator or {"type": "path", "max_depth": scene.max_depth + 1},
        "camera": {
            "type": "perspective",
            **_pose(mi, scene.camera),
            "near_clip": 0.1,
            "far_clip": 100.0,
            # Mitsuba's film moves the other way, in shares of its width and height.
            "principal_point_offset_x": float((cols - 1) / 2 - intrinsics[0, 2]) / cols,
            "principal_point_offset_y": float((rows - 1) / 2 - intrinsics[1, 2]) / rows,
            "film": {
                "type": "hdrfilm",
                "width": cols,
                "height": rows,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
        "projector": {
            "type": "projector",
            **_pose(mi, scene.projector),
            # Mitsuba defines the irradiance at distance 1; this makes it 1 at the target.
            "scale": scene.projector.distance**2,
            "irradiance": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.repeat(pattern[:, :, None], 3, axis=2).astype(np.float32)),
                "raw": True,
                "filter_type": "nearest",
                "wrap_mode": "clamp",
            },
        },
    }
    for number, part in enumerate(scene.parts):
        content[f"part{number}"] = _shape(mi, part, f"part{number}")
    return mi.load_dict(content)


def _pose(mi: ModuleType, view: View) -> dict[str, Any]:
    """Where a device stands, and the angle between the left and the right edge of its image."""
    _, down, forward = view.axes
    position = np.array(view.position)
    return {
        "fov": float(2 * np.degrees(np.arctan(view.width / 2 / view.distance))),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=position.tolist(), target=(position + forward).tolist(), up=(-down).tolist()
        ),
    }


def _shape(mi: ModuleType, part: Part, name: str) -> Any:
    mesh, properties = part.mesh, mi.Properties()
    properties["bsdf"] = mi.load_dict(dict(part.material))
    shape = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props=properties)
    if part.colours is not None:
        shape.add_attribute("vertex_color", 3, part.colours.astype(np.float32).ravel())
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape


# This many paths are traced at once. Chosen by hand: they fill all cores and take about 1 GiB.
WAVEFRONT = 1 << 20


def needed_bytes(size: tuple[int, int], channels: int = 1, entries: int = 1) -> int:
    """Memory that a rendering needs: the paths in flight, and `entries` for each sparse row."""
    # A path holds its ray, throughput and random state (200 bytes) and, at each of at most 20
    # points, a place, a value and their key (40 bytes). The renderer and the scene take 256 MiB.
    # An entry holds value, column and direct part, which exist twice while blocks are joined.
    return (256 << 20) + WAVEFRONT * (200 + 20 * 40) + size[0] * size[1] * channels * entries * 24


# Light paths from the camera, each vertex of which is connected to the projector.
#
# The whole of T comes from one pass. At each surface point of a path, the light that arrives
# straight from the projector came through one projector pixel, which the sampling of the emitter
# reports. What the path carries of it to the camera belongs to that entry of T.
#
# A path gives one to five such contributions, whatever the number of projector pixels. They are
# collected and then summed by one sort, so a rendering costs the same for any projector.


def sum_contributions(
    place: NDArray[np.uint32],
    value: NDArray[np.float32],
    direct: NDArray[np.bool_],
    shape: tuple[int, int],
) -> csr_array:
    """The sums of the light of n path vertices, complex64: all light + i direct light.

    `place` (n,) is row * N + column of T, which has at most 2^32 places. Zeros are dropped.
    """
    lit = value > 0
    value, direct = value[lit], direct[lit]
    bits = value.view(np.uint32) | (direct.astype(np.uint32) << np.uint32(31))
    # The key holds the place, then the value, whose unused sign bit marks direct light. One sort
    # of integers is several times faster than sorting the places and gathering the values.
    key = (place[lit].astype(np.uint64) << np.uint64(32)) | bits
    key.sort()
    places = (key >> np.uint64(32)).astype(np.uint32)
    bits = key.astype(np.uint32)
    values = (bits & np.uint32(0x7FFFFFFF)).view(np.float32).astype(np.float64)
    new = np.ones(len(places), bool)
    np.not_equal(places[1:], places[:-1], out=new[1:])
    starts = np.flatnonzero(new)
    data = np.empty(len(starts), np.complex64)
    if len(starts):
        data.real = np.add.reduceat(values, starts)
        data.imag = np.add.reduceat(values * (bits >> np.uint32(31)), starts)
    row, column = np.divmod(places[starts], np.uint32(shape[1]))
    indptr = np.searchsorted(row, np.arange(shape[0] + 1))
    return csr_array((data, column.astype(np.int32), indptr.astype(np.int32)), shape=shape)


def render(
    name: str,
    size: tuple[int, int],
    *,
    projector_size: tuple[int, int] | None = None,
    camera: int = 1,
    samples: int = 4096,
    seed: int = 0,
    keep: float = 0.999,
    colour: bool = False,
    progress: Progress | None = None,
) -> Truth:
    """Render the light transport matrix of a scene, direct and global light kept apart.

    Camera pixels are rendered in blocks that share a million paths. Each block is summed to sparse
    rows and thinned before the next begins, which takes about 1.2 GiB at any size. The result adds
    24 bytes per entry. Where that might not fit, a few camera pixels are rendered first to
    estimate it.

    Parameters
    ----------
    name : str
        A scene that `scenes` lists.
    size : (rows, cols)
        Camera size, and the projector's unless `projector_size` is given.
    projector_size : (rows, cols), optional
        Projector size. Of several projectors, the size of each; T then has the pixels of all, one
        projector above the other.
    camera : int
        Number of the camera, from 1 on, in scenes that have several.
    samples : int
        Paths per camera pixel. Too few make rows look sparser than they are.
    seed : int
        Seed of the paths.
    keep : float
        Share of each row's light that its largest entries must hold, in (0, 1]. The light of the
        smaller entries is gathered into fewer ones, so every row keeps its sum.
    colour : bool
        Whether a camera pixel has three samples (red, green, blue) instead of one.
    progress : callable, optional
        Called with (done, total) paths.

    Returns
    -------
    Truth
        Scaled so that at exposure 1 a fifth of the camera samples clip under their strongest
        single projector pixel. `metadata` holds the noise, estimated from two independent halves.

    Raises
    ------
    InputError
        On unknown scenes, sizes below 1, or more memory than there is.
    MissingExtraError
        If Mitsuba or LLVM is not installed.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> known = lm.render("wall", (32, 32), samples=64)  # doctest: +SKIP
    """
    scene = seen_by(find_scene(name), camera)
    projector = projector_size or size
    for device, shape in (("camera", size), ("projector", projector)):
        check_sides(f"a {device}", shape)
    check_seed(seed)
    if samples < 2:
        raise InputError(f"{samples} samples a pixel", hint="use at least 2, better 1024 or more")
    if not 0 < keep <= 1:
        raise InputError(f"keep is {keep}", hint="use a share of the energy such as 0.999")
    channels = 3 if colour else 1
    words = "a rendering of {}x{} camera by {}x{} projector pixels".format(*size, *projector)
    check_memory(words, needed_bytes(size, channels), "use a smaller size")
    started = time.perf_counter()
    mi = load_mitsuba()
    renderings = []
    for view in scene.projectors:
        loaded = mitsuba_scene(mi, replace(scene, projector=view), size, projector)
        about = (mi, loaded, size, projector, scene.max_depth, channels, samples, seed)
        renderings.append(_Rendering(*about, progress))
    rendering = renderings[0]
    most = min(rendering.pixels, samples * scene.max_depth)
    if needed_bytes(size, channels, most) > available_bytes():
        # The size of the result is estimated from a few camera pixels, with a margin of 30 %: they
        # cost little beside a rendering that might not fit.
        pixels = np.unique(np.linspace(0, size[0] * size[1] - 1, 24).astype(int))
        pilot = _Rendering(*about)
        thin = [thinned_in_steps(*pilot.rows(int(pixel), 1), keep)[0] for pixel in pixels]
        entries = 1.3 * float(np.mean([part.nnz for part in thin])) / channels
        needed = needed_bytes(size, channels, int(min(most, entries)))
        hint = "use a smaller size, fewer samples, or keep a smaller share of the light"
        check_memory(words, needed, hint)
    matrix, direct = rendering.matrix(keep)
    for other in renderings[1:]:
        # Direct light is the imaginary part of the same entries, so that both are joined alike.
        more, beside = other.matrix(keep)
        pairs = ((matrix, direct), (more, beside))
        both = [csr_array((m.data + 1j * d, m.indices, m.indptr), shape=m.shape) for m, d in pairs]
        joint = csr_array(hstack(both, format="csr"), dtype=np.complex64)
        parts = (joint.data.real.copy(), joint.indices, joint.indptr)
        matrix, direct = csr_array(parts, shape=joint.shape), joint.data.imag.copy()
        rendering.energies += other.energies
    # At exposure 1, a fifth of the rows clip under their strongest single pixel.
    level = float(np.quantile(matrix.max(axis=1).toarray(), 0.8))
    scale = 1 / level if level > 0 else 1.0
    matrix.data *= scale
    direct *= np.float32(scale)
    missed, total = rendering.energies.T
    # The relative noise of the mean of two halves.
    noise = np.sqrt(missed / np.maximum(total, 1e-30)).tolist()
    metadata = {
        "scene": name, "scene_version": scene.version, "samples": samples, "seed": seed,
        "keep": keep, "max_depth": scene.max_depth, "scale": float(scale),
        "noise_entries": noise[0], "noise_white": noise[1],
        "renderer": f"mitsuba {mi.__version__} {mi.variant()}",
        "seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip
    geometry: RigGeometry | None = view_geometry(scene, size, projector)
    if (several := len(renderings)) > 1:
        # A geometry is that of one projector.
        metadata |= {"camera": camera, PROJECTORS: [list(projector)] * several}
        geometry, projector = None, (several * projector[0], projector[1])
    camera_shape = (*size, 3) if colour else size
    return Truth(matrix, direct, camera_shape, projector, metadata, geometry)


@dataclass
class _Rendering:
    """One rendering: traces blocks of camera pixels, and keeps count of paths and noise."""

    # Mitsuba and the scene in it.
    mi: ModuleType
    scene: Any
    camera_shape: tuple[int, int]
    projector_shape: tuple[int, int]
    max_depth: int
    # Camera samples per camera pixel.
    channels: int
    samples: int
    seed: int
    progress: Progress | None = None
    # Energies of half the difference and of half the sum of the two halves of the samples: of the
    # entries, and of the white image.
    energies: NDArray[np.float64] = field(default_factory=lambda: np.zeros((2, 2)))
    paths_done: int = 0

    @property
    def pixels(self) -> int:
        """Projector pixels N."""
        return self.projector_shape[0] * self.projector_shape[1]

    def matrix(self, keep: float) -> tuple[csr_array, NDArray[np.float32]]:
        """All rows, thinned, and the direct part of each entry."""
        rows, cols = self.camera_shape
        total, half = rows * cols, self.samples - self.samples // 2
        # Half the samples of a block of camera pixels make up one wavefront.
        # The places of one block, camera samples times projector pixels, are numbered in 32 bits.
        most = (1 << 32) // (self.channels * self.pixels)
        block = min(total, max(1, min(WAVEFRONT // half, most)))
        return joined(
            [
                thinned_in_steps(*self.rows(first, min(block, total - first)), keep)
                for first in range(0, total, block)
            ]
        )

    def rows(self, first: int, count: int) -> tuple[csr_array, NDArray[np.float32]]:
        """The rows of some camera pixels, and the direct part of each entry."""
        halves = self._sums(first, count, 0), self._sums(first, count, 1)
        a: csr_array = halves[0].real / np.float32(self.samples - self.samples // 2)
        b: csr_array = halves[1].real / np.float32(self.samples // 2)
        white_a, white_b = np.asarray(a.sum(axis=1)), np.asarray(b.sum(axis=1))
        for number, (difference, total) in enumerate(
            (((a - b).data, (a + b).data), (white_a - white_b, white_a + white_b))
        ):
            self.energies[number] += [
                np.square(values, dtype=np.float64).sum() / 4 for values in (difference, total)
            ]
        both = csr_array((halves[0] + halves[1]) / np.float32(self.samples))
        whole = csr_array((both.data.real.copy(), both.indices, both.indptr), shape=both.shape)
        return whole, both.data.imag.copy()

    def _sums(self, first: int, count: int, half: int) -> csr_array:
        """Sums over one half of the samples, (count * channels, N): all light + i direct light."""
        samples = self.samples // 2 if half else self.samples - self.samples // 2
        rows, cols = self.camera_shape
        step = max(1, WAVEFRONT // count)
        sums = csr_array((count * self.channels, self.pixels), dtype=np.complex64)
        for number, start in enumerate(range(0, samples, step)):
            paths = min(step, samples - start)
            key = (self.seed, first, half, number)
            stream = int(np.random.SeedSequence(key).generate_state(1)[0])
            traced = self._traced(first, count, paths, stream)
            sums = traced if start == 0 else csr_array(sums + traced)
            self.paths_done += count * paths
            if self.progress is not None:
                self.progress(self.paths_done, rows * cols * self.samples)
        return sums

    def _traced(self, first: int, count: int, samples: int, seed: int) -> csr_array:
        """The light of `samples` paths from each of `count` camera pixels from `first` on.

        It is summed as in `sum_contributions`. Mitsuba's LLVM variant follows all paths at once,
        bounce by bounce.
        """
        import drjit as dr

        mi, scene, channels = self.mi, self.scene, self.channels
        paths = count * samples
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, paths)
        path = dr.arange(mi.UInt32, paths)
        block_pixel = path // samples
        # One contribution per path and depth.
        places = dr.zeros(mi.UInt32, paths * self.max_depth)
        values = [dr.zeros(mi.Float, paths * self.max_depth) for _ in range(channels)]
        row_start = block_pixel * (channels * self.pixels)
        # `first` is opaque to the compiler, so that one kernel serves all blocks.
        camera_pixel = block_pixel + dr.opaque(mi.UInt32, first)
        offset = sampler.next_2d()
        camera_rows, camera_cols = self.camera_shape
        film = mi.Point2f(
            (mi.Float(camera_pixel % camera_cols) + offset.x) / camera_cols,
            (mi.Float(camera_pixel // camera_cols) + offset.y) / camera_rows,
        )
        ray, weight = scene.sensors()[0].sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
        context = mi.BSDFContext()
        rows, cols = self.projector_shape

        def alive(active: Any, *_: Any) -> Any:
            return active

        def bounce(active: Any, ray: Any, throughput: Any, depth: Any, sampler: Any) -> Any:
            hit = scene.ray_intersect(ray, active)
            active &= hit.is_valid()
            bsdf = hit.bsdf(ray)
            point = sampler.next_2d(active)
            light, emitted = scene.sample_emitter_direction(hit, point, True, active)
            lit = active & (light.pdf > 0)
            value = throughput * bsdf.eval(context, hit, hit.to_local(light.d), lit) * emitted
            # The light came through this pixel of the projector.
            row = mi.UInt32(dr.clip(light.uv.y * rows, 0, rows - 1))
            col = mi.UInt32(dr.clip(light.uv.x * cols, 0, cols - 1))
            slot = depth * paths + path
            dr.scatter(places, row_start + row * cols + col, slot, lit)
            of_channels = [value.x, value.y, value.z] if channels == 3 else [dr.mean(value)]
            for target, channel in zip(values, of_channels, strict=True):
                dr.scatter(target, channel, slot, lit)
            sample, factor = bsdf.sample(
                context, hit, sampler.next_1d(active), sampler.next_2d(active), active
            )
            throughput *= factor
            ray = hit.spawn_ray(hit.to_world(sample.wo))
            depth += 1
            active &= (depth < self.max_depth) & (dr.max(throughput) > 0)
            return active, ray, throughput, depth, sampler

        dr.while_loop(
            (mi.Bool(True), mi.Ray3f(ray.o, ray.d), mi.Color3f(weight), mi.UInt32(0), sampler),
            alive,
            bounce,
            labels=("active", "ray", "throughput", "depth", "sampler"),
        )
        dr.eval(places, values)
        # Contributions of one depth stand together; those of depth 0, the direct light, come first.
        place = np.asarray(places.numpy())
        direct = np.arange(len(place)) < paths
        return sum_contributions(
            np.concatenate([place + np.uint32(c * self.pixels) for c in range(channels)]),
            np.concatenate([np.asarray(channel.numpy()) for channel in values]),
            np.tile(direct, channels),
            (count * channels, self.pixels),
        )
