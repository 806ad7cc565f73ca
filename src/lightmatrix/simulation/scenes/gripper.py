"""A robot gripper holding a ball on a sheet of paper, after the paper's Fig. 5 (b)."""

from __future__ import annotations

from lightmatrix.simulation.scenes.scene import Part, Scene, matt, metal, plastic
from lightmatrix.simulation.scenes.shapes import Mesh, ball, box, extrude, revolve, rod, sheet, turn

BODY = plastic((0.18, 0.19, 0.21), 0.2)
STEEL = metal("Cr", 0.3)
# The aluminium is bead-blasted, so that faces turned to the camera are not blinding.
ALUMINIUM = metal("Al", 0.42)
RUBBER = matt(0.06)
BOLT = metal("Cr", 0.25)


def build() -> Scene:
    """The scene: the gripper lies on its side, its lowest surfaces touching the paper."""
    parts = [
        Part(box(0.50, 0.62, 0.30, 0.025).placed((-0.42, 0.0, 0.0)), BODY),
        Part(box(0.30, 0.40, 0.06, 0.02).placed((-0.44, 0.0, 0.30)), ALUMINIUM),
        Part(_flange().placed((-0.70, 0.0, 0.20)), STEEL),
        Part(rod(0.055, 0.60).placed((-1.12, 0.0, 0.20)), STEEL),
        Part(box(0.18, 0.70, 0.26, 0.02).placed((-0.10, 0.0, 0.0)), ALUMINIUM),
        Part(ball(0.165).placed((0.62, 0.0, 0.0)), matt(0.8)),
    ]
    for side in (1, -1):
        parts += _finger(side)
        for x in (-0.54, -0.34):
            parts.append(Part(_screw().placed((x, 0.13 * side, 0.36)), BOLT))
            parts.append(Part(_screw().placed((x, 0.25 * side, 0.30)), BOLT))
        parts.append(Part(_screw().placed((-0.10, 0.28 * side, 0.26)), BOLT))
    paper = Part(sheet(), matt(0.8))
    placed = [Part(_in_place(part.mesh), part.material) for part in parts]
    description = "a robot gripper with metal fingers holding a ball, lying on white paper"
    return Scene("gripper", description, (paper, *placed), version=2)


def _in_place(mesh: Mesh) -> Mesh:
    """Enlarged about the paper's middle and turned, so that the gripper fills the view."""
    larger = Mesh(mesh.vertices * 1.1, mesh.faces)
    return larger.placed((-0.10, 0.0, 0.0), turn("z", 14))


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
    steel = [Part(piece.placed((0, 0, 0.08)), ALUMINIUM) for piece in pieces]
    feet = Part(box(0.09, 0.09, 0.08, 0.01).placed((0.20, side * 0.24, 0.0)), RUBBER)
    return [*steel, Part(pad, RUBBER), Part(joint, STEEL), feet]


def _flange() -> Mesh:
    profile = [(0.17, -0.04), (0.19, -0.025), (0.19, 0.025), (0.17, 0.04)]
    return revolve(profile).placed(rotation=turn("y", 90))


def _screw(radius: float = 0.035, height: float = 0.022) -> Mesh:
    return revolve([(radius, 0.0), (radius, 0.6 * height), (0.7 * radius, height)], 24)
