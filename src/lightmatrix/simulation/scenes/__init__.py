"""The scenes, one file each; `scene(name)` builds one."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches

from lightmatrix.errors import InputError
from lightmatrix.simulation.scenes import corner, gripper, l_objects, metal, translucent, vase, wall
from lightmatrix.simulation.scenes.scene import Scene

BUILDERS: dict[str, Callable[[], Scene]] = {
    "l_objects": l_objects.build,
    "gripper": gripper.build,
    "metal": metal.build,
    "corner": corner.build,
    "translucent": translucent.build,
    "wall": wall.build,
    "vase": vase.build,
}


def scene(name: str) -> Scene:
    """Build a scene; the error for an unknown name suggests similar ones."""
    if name not in BUILDERS:
        near = get_close_matches(name, BUILDERS, n=3, cutoff=0.4)
        advice = f"did you mean {' or '.join(near)}?" if near else "see `lightmatrix scenes`"
        raise InputError(f"there is no scene called {name!r}", hint=advice)
    return BUILDERS[name]()


def names() -> tuple[str, ...]:
    """Names of all scenes."""
    return tuple(BUILDERS)
