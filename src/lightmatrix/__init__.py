"""lightmatrix measures the light transport matrix of a projector-camera system, c = T p.

From a folder of projected patterns and a folder of photographs to T, from far fewer patterns than
projector pixels, and right although the camera clips.
"""

from __future__ import annotations

from importlib.metadata import version

__version__ = version("lightmatrix")
