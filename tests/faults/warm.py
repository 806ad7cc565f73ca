"""Imported by the fork server: what commands import, so that no child needs seconds for it."""

import contextlib
import gc
import importlib
import io
import pkgutil

import lightmatrix
from lightmatrix.cli import main

from . import run  # noqa: F401  its function is what children run

for _name in (
    *("zarr", "scipy.io", "scipy.signal", "scipy.sparse.linalg", "tifffile", "PIL.Image"),
    *("pytest", "matplotlib.pyplot", "rich.progress", "typer"),
    *(m.name for m in pkgutil.walk_packages(lightmatrix.__path__, "lightmatrix.", lambda _: None)),
):
    if not _name.endswith("__main__"):
        with contextlib.suppress(Exception):
            importlib.import_module(_name)
# What the first command of a process still loads and builds, whatever it does.
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    main(["info", "not-there.zarr", "--json"])
# What is here now is not looked at again, so that children need not copy it.
gc.collect()
gc.freeze()
