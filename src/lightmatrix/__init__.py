"""lightmatrix measures the light transport matrix T of a projector-camera system, c = T p.

It estimates T from projected patterns and their photographs. It needs far fewer patterns than the
projector has pixels, and is correct although the camera clips::

    import lightmatrix as lm

    capture = lm.Capture.open("capture/")
    transport = lm.estimate(capture, output="scene.zarr")
    photograph = transport.relight(pattern)

Before the photographs:

    plan                which patterns and exposures a scene needs, and which error to expect
    make_patterns       patterns of any kind by name; write_patterns writes them as images
    take_capture        projects patterns with a rig of `open_rig`, and photographs them
    simulate            photographs of a scene with known T, under the faults of a real camera

From photographs to T:

    Capture             patterns and photographs: a folder, image files or arrays
    ReadSettings        how photographs are read: black level, clipping, exposure, response, crop
    check               what is wrong with a capture, and what to do about it
    estimate            T, warning about each finding; EstimateSettings has every parameter
    estimate_colour     T of a colour projector: one matrix for each of its primaries
    fit_rig             what the rig did wrong in the course of a capture: shake, light, lag, curves
    verdicts            how far an estimate may be trusted
    evaluate            the error against a known T, which `truth` has for each of `scenes`
    report              a page about an estimate, with its error on photographs that it never saw

What is done with T:

    LightTransport      T in memory, with `relight`, `dual`, `row` and `column`; `save` stores it
    open                T from a store, read where it is used
    show                pictures of T: rows, columns, the dual image, maps of its diagnostics
    correspondence      which projector pixel each camera pixel sees; `decode` finds it of stripes
    triangulate         depth and shape, with the geometry of `calibrate_rig` or `self_calibrate`
    layers              surfaces seen through each other, and in mirrors
    separate            direct and global light
    compensate          the pattern that makes the scene look as a picture
    view                T in a notebook, to paint on; `serve_viewer` shows it in a browser
    export              T as a SciPy matrix in a file

Solvers by themselves:

    solve               solves a `Problem` of rows of T with ADMM, SaturationADMM, ROMP or ActiveSet

All errors are `LightMatrixError`, and all warnings `LightMatrixWarning`. `__init__.pyi` lists every
public name. Each is loaded when it is first used.
"""

import difflib
import sys
import types
from typing import Any

import lazy_loader


class _Package(types.ModuleType):
    """Keeps public functions such as `lm.check` when Python imports modules of their names."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, types.ModuleType) and name in __all__):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in __all__:
        return _loaded(name)
    alike = difflib.get_close_matches(name, __all__, 1)
    meant = f"; did you mean {alike[0]!r}?" if alike else ""
    raise AttributeError(f"module 'lightmatrix' has no attribute {name!r}{meant}")
