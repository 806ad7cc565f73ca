"""Pictures of a light transport matrix and of its diagnostics.

Modules that draw only when they are asked to write `pictures.style`, which loads Matplotlib then.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
