"""Pictures of T and its diagnostics; `pictures.style` loads Matplotlib when it is first used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
