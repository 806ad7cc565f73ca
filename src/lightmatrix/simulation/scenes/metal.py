"""Metallic industrial parts on a sheet of paper, after the paper's Fig. 5 (c)."""

from __future__ import annotations

from lightmatrix.simulation.scenes.scene import Part, Scene, matt, metal
from lightmatrix.simulation.scenes.shapes import bolt, bracket, from_quaternion, nut, ring, sheet

PARTS = {
    "bolt": (bolt(radius=0.062, length=0.46, head_radius=0.115, head_height=0.085), "Cr", 0.2),
    "nut": (nut(radius=0.14, hole=0.066, height=0.11), "Cr", 0.2),
    "washer": (ring(radius=0.17, hole=0.08, height=0.03), "Al", 0.25),
    "bearing": (ring(radius=0.20, hole=0.10, height=0.13), "Cr", 0.15),
    "bracket": (bracket(leg=0.36, thickness=0.045, width=0.30), "Al", 0.3),
}

# Where rigid parts came to rest after falling on the paper and on each other, computed once with a
# rigid-body simulation: position of the middle (x, y, z), then the quaternion (w, x, y, z).
POSES = (
    ("washer", (0.4758, 0.7094, 0.0150, 0.0001, -0.2137, 0.9769, -0.0000)),
    ("nut", (-0.8516, 0.7096, 0.1212, 0.5598, -0.5598, -0.4321, 0.4321)),
    ("washer", (-0.0541, 0.4705, 0.0150, 0.0003, -0.6957, 0.7183, -0.0002)),
    ("bracket", (0.7924, -0.9462, 0.1800, 0.1359, 0.1359, -0.6939, -0.6939)),
    ("bolt", (-0.7392, 0.4863, 0.0840, 0.2009, 0.7172, -0.1623, -0.6472)),
    ("washer", (0.2817, 0.6964, 0.0420, 0.7456, -0.0627, -0.0499, 0.6615)),
    ("bolt", (-0.8379, 0.2778, 0.0840, 0.4693, 0.5092, -0.5305, -0.4889)),
    ("bracket", (-0.3045, 0.3089, 0.1991, 0.6740, -0.0188, -0.7373, -0.0428)),
    ("nut", (0.5137, 0.7324, 0.1190, 0.8194, -0.1268, 0.0855, -0.5525)),
    ("nut", (0.6916, -0.2165, 0.0550, 0.9487, -0.0000, -0.0000, 0.3163)),
    ("bearing", (-0.1687, -0.6698, 0.0653, 0.0014, 0.8290, -0.5593, 0.0010)),
    ("bolt", (0.0804, -0.0322, 0.0920, 0.5793, 0.4712, 0.5777, 0.3296)),
    ("bolt", (0.1390, 0.5752, 0.1046, 0.6592, -0.6866, -0.2331, -0.1991)),
    ("bolt", (-0.6206, -0.4348, 0.0840, 0.0593, -0.0643, -0.7325, 0.6751)),
    ("nut", (0.0362, -0.2051, 0.1204, 0.0600, 0.1632, -0.9243, -0.3398)),
    ("bearing", (-0.2776, -0.0994, 0.1887, 0.3568, -0.7948, 0.4655, -0.1559)),
    ("washer", (0.6200, 0.4338, 0.0314, 0.0466, -0.6449, -0.7627, -0.0139)),
    ("bolt", (0.4245, -0.1744, 0.0840, 0.4517, 0.7198, 0.1503, -0.5052)),
    ("nut", (-0.2254, 0.3326, 0.1266, 0.8203, 0.0382, -0.0289, -0.5699)),
    ("bearing", (-0.2733, 0.4259, 0.2456, 0.0112, -0.9958, -0.0786, -0.0466)),
    ("bracket", (-0.6682, 0.0438, 0.2714, 0.5812, 0.3492, -0.6744, -0.2924)),
)


def build() -> Scene:
    """The scene."""
    parts = [Part(sheet(), matt(0.8))]
    for kind, pose in POSES:
        mesh, conductor, roughness = PARTS[kind]
        placed = mesh.placed(pose[:3], from_quaternion(pose[3:]))
        parts.append(Part(placed, metal(conductor, roughness)))
    description = "metal bolts, nuts, washers, rings and brackets strewn on white paper"
    return Scene("metal", description, tuple(parts))
