"""The scenes of the simulator: meshes and materials above the plane z = 0, seen from above.

Camera and projector look straight down by default. Both then see the square |x|, |y| <= 1 of the
plane z = 0, as after the paper's alignment by a homography, and points above the plane with
parallax. A `View` with a target is turned towards it instead.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache, partial
from importlib.resources import files
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.errors import InputError
from lightmatrix.simulation.shapes import (
    Mesh,
    ball,
    bolt,
    box,
    bracket,
    extrude,
    l_block,
    merge,
    nut,
    polygon,
    revolve,
    ring,
    rod,
    rotation,
    sheet,
    turn,
)


@dataclass(frozen=True)
class View:
    """A device at a position that looks at a target.

    Parameters
    ----------
    position : (x, y, z)
        Its centre.
    target : (x, y, z), optional
        The point in the middle of its image. None: it looks straight down, and its film is shifted
        such that it covers the square |x|, |y| <= 1 of the plane z = 0.
    roll : float
        How far it is turned about its axis, in degrees, clockwise as seen from behind.
    width : float
        Width of its image in the plane through the target at right angles to the axis; 2 covers the
        square |x|, |y| <= 1.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float] | None = None
    roll: float = 0.0
    width: float = 2.0

    @property
    def distance(self) -> float:
        """From the centre to the target, or straight down to the plane z = 0."""
        if self.target is None:
            return self.position[2]
        return float(np.linalg.norm(np.subtract(self.target, self.position)))

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors (3, 3): to the right, down and forwards in its image."""
        x, y, _ = self.position
        forward = np.subtract((x, y, 0) if self.target is None else self.target, self.position)
        forward = forward / np.linalg.norm(forward)
        # The scene's y points up in an image that is not turned.
        right = np.cross(forward, (0, 1, 0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        c, s = np.cos(np.radians(self.roll)), np.sin(np.radians(self.roll))
        return np.stack([c * right + s * down, c * down - s * right, forward])

    def intrinsics(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """K (3, 3) for an image of (rows, cols) with pixel centres at whole numbers."""
        rows, cols = shape
        focal = cols * self.distance / self.width
        # A shifted film keeps the middle of the square in the middle of the image.
        x, y = (self.position[0], self.position[1]) if self.target is None else (0.0, 0.0)
        across, down = x * cols / self.width, -y * cols / self.width
        return np.array(
            [[focal, 0, (cols - 1) / 2 + across], [0, focal, (rows - 1) / 2 + down], [0, 0, 1]]
        )

    def matrix(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """The projection (3, 4) of (x, y, z, 1) to (col, row, 1) for an image of (rows, cols)."""
        turn = self.axes
        return self.intrinsics(shape) @ np.column_stack([turn, -turn @ self.position])


Material = Mapping[str, Any]
# Where camera and projector stand in most scenes.
_CAMERA, _PROJECTOR = View((-0.8, -0.5, 4.0)), View((0.0, 0.0, 4.0))


def matt(reflectance: float | tuple[float, float, float]) -> Material:
    """A diffuse surface, seen from both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _rgb(reflectance)}}


def painted() -> Material:
    """A diffuse surface whose reflectance varies: `Part.colours`, between vertices linearly."""
    texture = {"type": "mesh_attribute", "name": "vertex_color"}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": texture}}


def plastic(reflectance: float | tuple[float, float, float], roughness: float) -> Material:
    """A glossy coat over a diffuse base."""
    base = {"type": "roughplastic", "diffuse_reflectance": _rgb(reflectance), "alpha": roughness}
    return {"type": "twosided", "bsdf": base}


def metal(kind: str, roughness: float) -> Material:
    """A rough conductor; a mirror (roughness below 0.12) would never reflect a pinhole light."""
    base = {"type": "roughconductor", "material": kind, "alpha": roughness}
    return {"type": "twosided", "bsdf": base}


def _rgb(value: float | tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [value] * 3 if isinstance(value, float) else list(value)}


@dataclass(frozen=True)
class Part:
    """A mesh and its material; `painted` materials take a colour (V, 3) for each vertex."""

    mesh: Mesh
    material: Material
    colours: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Scene:
    """A scene of the simulator: everything that reflects light, the camera and the projector."""

    name: str
    description: str
    parts: tuple[Part, ...]
    # The longest light path, in surface interactions.
    max_depth: int = 10
    # Raised whenever the scene changes, so that cached matrices are rendered again.
    version: int = 1
    camera: View = _CAMERA
    # Its image is centred on its axis, since Mitsuba's projector has no shifted film.
    projector: View = _PROJECTOR
    # Further ones beside the first: projectors that all light the scene, cameras that all see it.
    more_projectors: tuple[View, ...] = ()
    more_cameras: tuple[View, ...] = ()

    @property
    def projectors(self) -> tuple[View, ...]:
        """All projectors."""
        return self.projector, *self.more_projectors

    @property
    def cameras(self) -> tuple[View, ...]:
        """All cameras."""
        return self.camera, *self.more_cameras


def _at_rest(name: str) -> list[tuple[str, Callable[[Mesh], Mesh]]]:
    """The parts that were strewn over a scene, by name, and what puts each in its place.

    A rigid-body simulation let them fall on a table and on each other. The file holds the name, the
    position of the middle (x, y, z), and the quaternion (w, x, y, z) of each.
    """
    text = (files("lightmatrix.simulation") / "data" / "poses.json").read_text()
    placed = list[tuple[str, Callable[[Mesh], Mesh]]]()
    for part, *place, w, x, y, z in json.loads(text)[name]:
        unit = np.array((w, x, y, z)) / np.linalg.norm((w, x, y, z))
        placed.append(
            (part, partial(Mesh.placed, position=place, rotation=rotation(unit[0], unit[1:])))
        )
    return placed


def _l_objects() -> Scene:
    """A random pile of white L-shaped objects, as in the paper's Fig. 5 (a)."""
    block = l_block(leg=0.56, width=0.19, height=0.17)
    blocks = [Part(placed(block), matt(0.85)) for _, placed in _at_rest("l_objects")]
    parts = [Part(sheet(), matt(0.35)), *blocks]
    return Scene(
        "l_objects", "a random pile of white L-shaped blocks on a grey table", tuple(parts)
    )


_BODY = plastic((0.18, 0.19, 0.21), 0.2)
_STEEL = metal("Cr", 0.3)
# The aluminium is bead-blasted, so that faces turned to the camera are not blinding.
_ALUMINIUM = metal("Al", 0.42)
_RUBBER = matt(0.06)
_BOLT = metal("Cr", 0.25)


def _gripper() -> Scene:
    """A robot gripper holding a ball, after the paper's Fig. 5 (b).

    It lies on its side on a sheet of paper, its lowest surfaces touching it.
    """
    profile = [(0.17, -0.04), (0.19, -0.025), (0.19, 0.025), (0.17, 0.04)]
    flange = revolve(profile).placed(rotation=turn("y", 90))
    parts = [
        Part(box(0.50, 0.62, 0.30, 0.025).placed((-0.42, 0.0, 0.0)), _BODY),
        Part(box(0.30, 0.40, 0.06, 0.02).placed((-0.44, 0.0, 0.30)), _ALUMINIUM),
        Part(flange.placed((-0.70, 0.0, 0.20)), _STEEL),
        Part(rod(0.055, 0.60).placed((-1.12, 0.0, 0.20)), _STEEL),
        Part(box(0.18, 0.70, 0.26, 0.02).placed((-0.10, 0.0, 0.0)), _ALUMINIUM),
        Part(ball(0.165).placed((0.62, 0.0, 0.0)), matt(0.8)),
    ]
    for side in (1, -1):
        parts += _finger(side)
        for x in (-0.54, -0.34):
            parts.append(Part(_screw().placed((x, 0.13 * side, 0.36)), _BOLT))
            parts.append(Part(_screw().placed((x, 0.25 * side, 0.30)), _BOLT))
        parts.append(Part(_screw().placed((-0.10, 0.28 * side, 0.26)), _BOLT))
    paper = Part(sheet(), matt(0.8))
    # Enlarged about the paper's middle and turned, the gripper fills the view.
    placed = []
    for part in parts:
        larger = Mesh(part.mesh.vertices * 1.1, part.mesh.faces)
        placed.append(Part(larger.placed((-0.10, 0.0, 0.0), turn("z", 14)), part.material))
    description = "a robot gripper with metal fingers holding a ball, lying on white paper"
    return Scene("gripper", description, (paper, *placed), version=2)


def _finger(side: int) -> list[Part]:
    """One finger: the arm in two convex-enough pieces, its joint and its rubber pad."""
    root = [(-0.02, 0.14), (0.16, 0.14), (0.30, 0.235), (0.30, 0.40), (0.26, 0.40), (0.04, 0.29)]
    root.append((-0.02, 0.27))
    tip = [(0.30, 0.235), (0.36, 0.27), (0.74, 0.17), (0.81, 0.20), (0.79, 0.27), (0.37, 0.41)]
    tip.append((0.30, 0.40))
    pieces = []
    for outline, centre in ((root, (0.16, 0.24)), (tip, (0.42, 0.33))):
        flipped = [(x, side * y) for x, y in outline][::side]
        pieces.append(extrude(flipped, 0.16, 0.012, (centre[0], side * centre[1])))
    pad = box(0.22, 0.04, 0.14, 0.008).placed((0.66, side * 0.185, 0.05), turn("z", -15.0 * side))
    joint = _screw(0.05, 0.03).placed((0.30, side * 0.32, 0.24))
    steel = [Part(piece.placed((0, 0, 0.08)), _ALUMINIUM) for piece in pieces]
    feet = Part(box(0.09, 0.09, 0.08, 0.01).placed((0.20, side * 0.24, 0.0)), _RUBBER)
    return [*steel, Part(pad, _RUBBER), Part(joint, _STEEL), feet]


def _screw(radius: float = 0.035, height: float = 0.022) -> Mesh:
    return revolve([(radius, 0.0), (radius, 0.6 * height), (0.7 * radius, height)], 24)


_PARTS = {
    "bolt": (bolt(radius=0.062, length=0.46, head_radius=0.115, head_height=0.085), "Cr", 0.2),
    "nut": (nut(radius=0.14, hole=0.066, height=0.11), "Cr", 0.2),
    "washer": (ring(radius=0.17, hole=0.08, height=0.03), "Al", 0.25),
    "bearing": (ring(radius=0.20, hole=0.10, height=0.13), "Cr", 0.15),
    "bracket": (bracket(leg=0.36, thickness=0.045, width=0.30), "Al", 0.3),
}


def _metal() -> Scene:
    """Metallic industrial parts on a sheet of paper, after the paper's Fig. 5 (c)."""
    parts = [Part(sheet(), matt(0.8))]
    for kind, placed in _at_rest("metal"):
        mesh, conductor, roughness = _PARTS[kind]
        parts.append(Part(placed(mesh), metal(conductor, roughness)))
    description = "metal bolts, nuts, washers, rings and brackets strewn on white paper"
    return Scene("metal", description, tuple(parts))


# Height of the edge where the walls meet: the plane z = 0 cuts the walls, so that half of their lit
# parts lies below it and half above.
_EDGE = -0.6


def _corner() -> Scene:
    """A concave corner of two white walls: strong interreflection, no bright single response.

    It is a right-angled valley, its edge along y, with a cube and a ball that cast shadows.
    """
    # Objects keep a gap to the walls, so that surfaces do not coincide.
    side, radius, gap = 0.40, 0.19, 0.001
    cube = (
        box(side, side, side, 0.012)
        .placed((0, 0, -side / 2), np.eye(3))
        .placed((0.0, 0.42, _EDGE + side / sqrt(2) + gap), turn("y", 45))
    )
    rolled = ball(radius).placed((0.0, -0.40, _EDGE + radius * (sqrt(2) - 1) + gap))
    description = (
        "two white walls, a cube and a ball in the valley between them: strong global light"
    )
    parts = tuple(Part(mesh, matt(0.9)) for mesh in (_valley(), cube, rolled))
    return Scene(
        "corner", description, parts, max_depth=20, version=2, camera=View((-0.3, -0.2, 4.0))
    )


def _valley(rim: float = 1.5, half: float = 3.0) -> Mesh:
    """Two walls at right angles that meet in the line x = 0, z = _EDGE."""
    lines = [(_EDGE - rim, rim), (0.0, _EDGE), (rim - _EDGE, rim)]
    points = [[x, y, z] for x, z in lines for y in (-half, half)]
    faces = [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]
    return Mesh(np.array(points), np.array(faces))


# A thin sheet that scatters light to both sides; with diff_trans=1 it would send half through.
_PAPER: Material = {
    "type": "principledthin", "base_color": _rgb(0.88), "diff_trans": 1.1, "roughness": 0.6,
    "spec_trans": 0.0, "eta": 1.3,
}  # fmt: skip
_GLAZE = plastic((0.72, 0.70, 0.66), 0.14)


def _translucent() -> Scene:
    """Translucent paper and glossy crockery on a board: wide footprints.

    A corrugated sheet on bars, a bowl, and a paper cup through which light scatters.
    """
    parts = [
        Part(sheet(), matt(0.55)),
        Part(_bowl().placed((0.44, -0.42, 0.0)), _GLAZE),
        Part(_cup().placed((0.50, 0.52, 0.0)), _PAPER),
    ]
    leaning = turn("z", 12)
    for x in (-0.36, 0.36):
        bar = box(0.07, 1.30, 0.16, 0.012).placed((x, 0.0, 0.0))
        parts.append(Part(bar.placed((-0.46, 0.12, 0.0), leaning), matt(0.3)))
    parts.append(Part(_corrugated().placed((-0.46, 0.12, 0.0), leaning), _PAPER))
    description = (
        "a corrugated sheet and a cup of translucent paper, a glazed bowl: wide footprints"
    )
    return Scene("translucent", description, tuple(parts), max_depth=14, version=2)


def _bowl() -> Mesh:
    """A bowl with a foot and a rounded rim, turned from a smooth profile."""
    t = np.linspace(0, np.pi / 2, 16)
    foot = [(0.10, 0.0), (0.17, 0.0), (0.18, 0.02)]
    outside = [(0.18 + 0.26 * np.sin(a), 0.04 + 0.24 * (1 - np.cos(a))) for a in t]
    # A half circle of radius 0.012 between the walls.
    lip = [(0.428 + 0.012 * np.cos(a), 0.28 + 0.012 * np.sin(a)) for a in np.linspace(0, np.pi, 8)]
    inside = [(0.416 * np.sin(a), 0.05 + 0.23 * (1 - np.cos(a))) for a in t[::-1]]
    profile = [*foot, *outside, *lip, *inside[:-1], (0.001, 0.05)]
    return revolve(profile, 96)


def _cup() -> Mesh:
    """A paper cup, open at the top: one surface that scatters to both sides."""
    steps = np.linspace(0, 1, 8)
    profile = [(0.001, 0.004), (0.22, 0.004), *((0.22 + 0.08 * s, 0.004 + 0.36 * s) for s in steps)]
    closed = revolve(profile, 96)
    # `revolve` closes both ends; the fan over the opening is left out.
    top = len(closed.vertices) - 2
    return Mesh(closed.vertices, closed.faces[~(closed.faces == top).any(axis=1)])


def _corrugated(width: float = 0.86, length: float = 1.12, waves: int = 7) -> Mesh:
    """A sheet with waves along x whose troughs touch bars of height 0.16."""
    steps = 12 * waves
    x = np.linspace(-width / 2, width / 2, steps + 1)
    z = 0.161 + 0.028 * (1 - np.cos(2 * np.pi * waves * x / width + np.pi * (waves % 2)))
    near = np.column_stack([x, np.full_like(x, -length / 2), z])
    far = near + np.array([0, length, 0])
    i = np.arange(steps)
    j = i + steps + 1
    faces = np.concatenate([np.stack([i, i + 1, j + 1], 1), np.stack([i, j + 1, j], 1)])
    return Mesh(np.concatenate([near, far]), faces)


def _wall() -> Scene:
    """A flat white wall: the control, where T is nearly the identity and nothing is global."""
    return Scene("wall", "a flat white wall: direct light only", (Part(sheet(), matt(0.8)),), 2)


_LENGTH = 1.1


def _vase_scene() -> Scene:
    """A painted vase seen from the side by a turned camera: a wide baseline, no straight lines.

    It lies on its side with painted bands and petals, two balls, and a matt sheet.
    """
    vase = _vase()
    lying = vase.placed((-0.42, -0.42, 0.377), _lying())
    parts = (
        Part(sheet(6.0), matt(0.55)),
        Part(lying, painted(), _paint(vase)),
        Part(ball(0.16).placed((0.62, -0.38, 0.0)), matt(0.8)),
        Part(ball(0.12).placed((-0.55, 0.50, 0.0)), matt(0.35)),
    )
    return Scene(
        "vase",
        "a painted vase and two balls, seen from the side by a turned camera: a wide baseline",
        parts,
        camera=View((-1.6, -0.7, 3.5), target=(0.0, 0.0, 0.15), roll=17.0, width=1.7),
        projector=View((0.55, 0.25, 4.0), target=(0.0, 0.0, 0.15), roll=-6.0),
    )


def _vase() -> Mesh:
    """The vase standing on z = 0: a belly, a neck and a lip."""
    # The vertices are finer than the pixels of a megapixel camera, so that paint looks smooth.
    t = np.linspace(0, 1, 128)
    belly = 0.30 * np.exp(-(((t - 0.36) / 0.26) ** 2))
    lip = 0.10 * np.exp(-(((t - 1.0) / 0.09) ** 2))
    return revolve(np.column_stack([0.10 + belly + lip, _LENGTH * t]), 192)


def _lying() -> NDArray[np.float64]:
    """Rotation that lays the vase's axis into the plane, its neck to the upper right."""
    angle = np.radians(35)
    axis = np.array([np.cos(angle), np.sin(angle), 0.06])
    axis /= np.linalg.norm(axis)
    side = np.cross((0, 0, 1), axis)
    side /= np.linalg.norm(side)
    return np.column_stack([np.cross(side, axis), side, axis])


def _paint(vase: Mesh) -> NDArray[np.float64]:
    """Reflectance (V, 3) of the vase's vertices: dark petals on a light glaze between two bands."""
    x, y, z = vase.vertices.T
    around, along = np.arctan2(y, x), z / _LENGTH
    petals = 0.5 + 0.5 * np.sin(9 * around) * np.sin(2 * np.pi * 4.5 * along)
    bands = np.exp(-(((along - 0.74) / 0.02) ** 2)) + np.exp(-(((along - 0.08) / 0.02) ** 2))
    level = 0.25 + 0.55 * np.where(np.abs(petals - 0.5) < 0.22, petals, np.round(petals))
    glaze = level[:, None] * np.array([1.0, 0.92, 0.85])
    blue = np.array([0.10, 0.14, 0.38])
    share = np.clip(bands, 0, 1)[:, None]
    return glaze * (1 - share) + blue * share


def _mirror_balls() -> Scene:
    """A pile of polished balls on a matt table, which see the table and each other.

    Stripes and codes fail there: a camera pixel sees the same light by several ways.
    """
    # Six balls touch each other around a seventh, and three lie in the hollows between them.
    polished, radius, up = metal("Ag", 0.12), 0.25, 0.25 * sqrt(8 / 3)
    places = [(0.0, 0.0, 0.0), *((x, y, 0.0) for x, y in polygon(6, 2 * radius))]
    places += [(x, y, up) for x, y in polygon(12, 2 * radius / sqrt(3))[1::4]]
    balls = [Part(ball(radius, 64).placed(place), polished) for place in places]
    around = ((-0.78, -0.70), (0.80, 0.66), (-0.72, 0.74), (0.74, -0.78), (0.02, -0.84))
    balls += [Part(ball(0.15, 64).placed((x, y, 0.0)), polished) for x, y in around]
    description = "a pile of polished metal balls on a matt table: light by several ways"
    return Scene("mirror_balls", description, (Part(sheet(), matt(0.7)), *balls))


def _flakes(cell: float, cover: NDArray[np.float64], seed: int) -> Mesh:
    """Squares of side `cell` that cover a share (n, n) of the plane z = 0 at random.

    They are smaller than pixels, which see what is behind too, and without a pattern or moire.
    """
    rows, cols = np.nonzero(np.random.default_rng(seed).random(cover.shape) < cover)
    middle = np.array(cover.shape) / 2
    x = (cols[:, None] + (0, 1, 1, 0) - middle[1]) * cell
    y = (rows[:, None] + (0, 0, 1, 1) - middle[0]) * cell
    corners = np.arange(4 * len(rows)).reshape(-1, 4)
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return Mesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces)


def _curtain() -> Scene:
    """A wavy curtain of fine threads that hides half of the painted things behind it."""
    cloth = _flakes(0.007, np.full((230, 230), 0.5), 1)
    wavy = cloth.vertices + 0.04 * np.sin(5 * cloth.vertices[:, :1]) * (0, 0, 1)
    hanging = Mesh(wavy, cloth.faces).placed((0.0, 0.0, 1.2), turn("x", 6))
    vase = _vase()
    parts = (
        Part(sheet(), matt(0.6)),
        Part(vase.placed((-0.42, -0.42, 0.377), _lying()), painted(), _paint(vase)),
        Part(ball(0.3).placed((0.5, -0.3, 0.0)), matt(0.8)),
        Part(hanging, matt(0.8)),
    )
    return Scene("curtain", "painted things behind a curtain that covers half of them", parts, 6)


def _glass() -> Scene:
    """A leaning glass plate with dust in patches before a wall; glass itself returns no light."""
    place = np.linspace(0, 3 * np.pi, 300)
    cover = 0.25 + 0.1 * np.sin(place) * np.sin(place[:, None] + 1)
    dust = _flakes(0.006, cover, 2).placed((0.0, 0.0, 0.8), turn("y", 14))
    parts = (Part(sheet(), matt(0.7)), Part(dust, matt(0.9)))
    return Scene("glass", "a dusty glass plate that leans before a wall", parts, 6)


# The mirror is a sheet, turned by so many degrees about the y axis and moved to this place, in
# scene units. The places of what it shows follow from both.
MIRROR_TURN, MIRROR_PLACE = -70.0, (0.35, 0.0, 0.5)


def _statue() -> Mesh:
    profile = [(0.34, 0.0), (0.34, 0.1), (0.24, 0.14), (0.2, 0.35), (0.14, 0.5), (0.06, 0.56)]
    return merge([revolve(profile, 128), ball(0.15, 64).placed((0.0, 0.0, 0.5))])


def _mirror() -> Scene:
    """A statue beside a dusty mirror."""
    silver = {"type": "conductor", "material": "Ag"}
    dusty = {"type": "blendbsdf", "weight": 0.4, "bsdf_0": silver, "bsdf_1": matt(0.7)["bsdf"]}
    plate = sheet(1.1).placed(MIRROR_PLACE, turn("y", MIRROR_TURN))
    stone = Part(_statue().placed((-0.5, 0.0, 0.0)), matt(0.85))
    parts = (Part(sheet(), matt(0.4)), Part(plate, {"type": "twosided", "bsdf": dusty}), stone)
    return Scene("mirror", "a statue beside a dusty mirror that shows it", parts, 6)


# Two projectors, left and right. In a corner each lights 44 % of what the other does. The second
# hangs upside down. The second camera sees the scene from the side.
_LEFT = View((-1.1, 0.2, 4.0), target=(-0.45, 0.0, 0.0), roll=4.0, width=1.35)
_RIGHT = View((0.9, -0.1, 3.6), target=(0.45, 0.0, 0.0), roll=175.0, width=1.35)
_FRONT = View((-0.2, -0.3, 4.0), target=(0.0, 0.0, 0.0), width=2.3)
_SIDE = View((1.3, -1.0, 3.6), target=(0.0, 0.0, 0.0), roll=8.0, width=2.3)


def _stage() -> Scene:
    """A corner of two white walls under two projectors."""
    return Scene(
        "stage",
        "a white corner under two projectors, seen by two cameras",
        (Part(_valley(), matt(0.8)),),
        camera=_FRONT,
        projector=_LEFT,
        more_projectors=(_RIGHT,),
        more_cameras=(_SIDE,),
    )


def _statues() -> Scene:
    """Two statues on a table under two projectors, each of which lights both from its side."""
    stone = _statue()
    places = ((-0.42, -0.3, 0.0), (0.42, 0.3, 0.0))
    parts = (Part(sheet(6.0), matt(0.5)), *(Part(stone.placed(at), matt(0.85)) for at in places))
    return replace(
        _stage(),
        name="statues",
        description="two statues under two projectors, seen by two cameras",
        parts=parts,
        max_depth=6,
    )


def _dome() -> Scene:
    """The inside of a white dome under two projectors, whose light it throws to and fro."""
    radius, angles = 1.5, np.linspace(1.0, 0.02, 64)
    inside = np.column_stack([radius * np.sin(angles), radius * (1 - np.cos(angles))])
    dome = revolve([(1.4, 0.0), (1.4, inside[0, 1]), *inside.tolist()], 128)
    return replace(
        _stage(),
        name="dome",
        description="the inside of a white dome under two projectors, seen by two cameras",
        parts=(Part(sheet(6.0), matt(0.2)), Part(dome, matt(0.8))),
        projector=replace(_LEFT, target=(-0.5, 0.0, 0.1)),
        more_projectors=(replace(_RIGHT, target=(0.5, 0.0, 0.1)),),
        max_depth=8,
    )


BUILDERS: dict[str, Callable[[], Scene]] = {
    "l_objects": _l_objects, "gripper": _gripper, "metal": _metal, "corner": _corner,
    "translucent": _translucent, "wall": _wall, "vase": _vase_scene, "mirror_balls": _mirror_balls,
    "curtain": _curtain, "glass": _glass, "mirror": _mirror, "stage": _stage, "statues": _statues,
    "dome": _dome,
}  # fmt: skip


@cache
def scene(name: str) -> Scene:
    """Build a scene; the error for an unknown name suggests similar ones."""
    if name not in BUILDERS:
        near = get_close_matches(name, BUILDERS, n=3, cutoff=0.4)
        advice = f"did you mean {' or '.join(near)}?" if near else "see `lightmatrix scenes`"
        raise InputError(f"there is no scene called {name!r}", hint=advice)
    return BUILDERS[name]()


def seen_by(built: Scene, camera: int) -> Scene:
    """The scene with one of its cameras, numbered from 1 on."""
    cameras = built.cameras
    if not 1 <= camera <= len(cameras):
        hint = f"{built.name} has {len(cameras)}"
        raise InputError(f"camera {camera} of {built.name}", hint=hint)
    return replace(built, camera=cameras[camera - 1])


def names() -> tuple[str, ...]:
    """Names of all scenes."""
    return tuple(BUILDERS)
