"""lightmatrix measures the light transport matrix of a projector-camera system, c = T p.

From a folder of projected patterns and a folder of photographs to T, from far fewer patterns than
projector pixels, and right although the camera clips::

    import lightmatrix as lm

    capture = lm.Capture.open("capture/")
    transport = lm.estimate(capture, output="scene.zarr")
    photograph = transport.relight(pattern)

All that there is to use stands in this one namespace, which `__init__.pyi` lists; each name is
loaded when it is first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
