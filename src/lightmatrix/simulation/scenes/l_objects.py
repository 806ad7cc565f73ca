"""A random pile of white L-shaped objects, as in the paper's Fig. 5 (a)."""

from __future__ import annotations

from lightmatrix.simulation.scenes.scene import Part, Scene, matt
from lightmatrix.simulation.scenes.shapes import from_quaternion, l_block, sheet

# Where rigid blocks came to rest after falling on a table and on each other, computed once with a
# rigid-body simulation: position of the middle (x, y, z), then the quaternion (w, x, y, z).
POSES = (
    (0.3821, -0.0159, 0.0850, 0.0000, -0.8563, 0.5165, -0.0000),
    (-0.7430, 0.4119, 0.0850, 0.5179, -0.0000, 0.0000, 0.8554),
    (0.3180, -0.5462, 0.0850, 0.7394, -0.0000, -0.0000, 0.6732),
    (-0.0561, 0.7807, 0.0850, 0.0000, -0.1452, -0.9894, -0.0000),
    (-0.5580, -1.2624, 0.0850, -0.0000, 0.0220, -0.9998, -0.0000),
    (0.2652, -0.7279, 0.1377, 0.3049, -0.6637, -0.2440, 0.6380),
    (-0.3075, -0.8097, 0.1855, 0.0720, 0.9113, -0.3627, 0.1810),
    (-0.1087, -0.1340, 0.1963, 0.0456, 0.2035, 0.9544, 0.2138),
    (-0.3178, -0.1055, 0.2787, 0.2507, 0.5231, -0.7765, 0.2462),
    (0.3035, -0.1450, 0.3360, 0.1537, 0.0085, -0.9881, 0.0013),
    (0.2557, 0.5760, 0.2044, 0.0650, -0.2611, -0.9364, 0.2253),
)


def build() -> Scene:
    """The scene."""
    block = l_block(leg=0.56, width=0.19, height=0.17)
    blocks = [block.placed(pose[:3], from_quaternion(pose[3:])) for pose in POSES]
    parts = [Part(sheet(), matt(0.35)), *(Part(mesh, matt(0.85)) for mesh in blocks)]
    return Scene(
        "l_objects", "a random pile of white L-shaped blocks on a grey table", tuple(parts)
    )
