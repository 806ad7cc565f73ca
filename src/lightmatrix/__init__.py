"""lightmatrix measures the light transport matrix T of a projector-camera system, c = T p.

It estimates T from projected patterns and their photographs. It needs far fewer patterns than the
projector has pixels, and is correct although the camera clips::

    import lightmatrix as lm

    capture = lm.Capture.open("capture/")
    transport = lm.estimate(capture, output="scene.zarr")
    photograph = transport.relight(pattern)

`__init__.pyi` lists every public name. Each is loaded when it is first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
