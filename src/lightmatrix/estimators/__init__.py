"""From a capture to a light transport matrix. Start at `estimate.py`.

Code that rarely estimates, such as `capture`, takes its modules from here, which loads them then.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
