"""Runs the command line or tests in a process that behaves like Windows, as far as Linux can.

    python -m tests.helpers.windows_like FOLDER
    python -m tests.helpers.windows_like pytest tests/files/test_writing.py

The first writes every kind of output into a folder. The second runs tests, except those that are
marked as needing more than Windows has (`systems.py`).

Modules and functions that Windows lacks are removed, and files behave as on Windows:
nothing is renamed onto what exists, folders are not replaced, and what is open or mapped into
memory is neither removed nor renamed, nor is a folder that holds it. Libraries are loaded
before, since they ask for the system too; filelock keeps its locks of POSIX, but removes a lock
file as it does on Windows.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import shutil
import signal
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

LIBRARIES = (
    "asyncio", "concurrent.futures", "filelock", "jinja2", "matplotlib.pyplot",
    "numpy", "psutil", "platformdirs", "rich.console", "rich.progress", "rich.table", "scipy.io",
    "scipy.sparse", "scipy.fft", "scipy.ndimage", "tempfile", "tifffile", "typer", "typer.testing",
    "zarr", "multiprocessing", "subprocess", "PIL.Image",
)  # fmt: skip
MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "pty", "tty", "posix", "readline")
OF_OS = (
    "O_NOFOLLOW", "O_NONBLOCK", "O_DIRECTORY", "register_at_fork", "posix_fallocate", "fork",
    "sched_getaffinity", "getuid", "geteuid", "mkfifo", "killpg", "getpgid", "chown",
)  # fmt: skip
OF_SIGNAL = ("SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGPIPE", "pthread_sigmask")


def _open_files() -> set[str]:
    """The files that this process has open or mapped into memory."""
    files = set()
    for entry in os.listdir("/proc/self/fd"):
        try:
            files.add(os.readlink(f"/proc/self/fd/{entry}"))
        except FileNotFoundError:
            continue
    lines = Path("/proc/self/maps").read_text().splitlines()
    return files | {line.split(None, 5)[5] for line in lines if line.count("/")}


def _check_closed(path: Any) -> None:
    whole = os.path.realpath(path)
    if any(name == whole or name.startswith(whole + os.sep) for name in _open_files()):
        raise PermissionError(13, "The process cannot access the file: it is being used", str(path))


def _removing(real: Callable[..., None]) -> Callable[..., None]:
    def remove(path: Any, **more: Any) -> None:
        _check_closed(path)
        real(path, **more)

    return remove


def _renaming(real: Callable[..., None], replaces: bool) -> Callable[..., None]:
    def rename(source: Any, target: Any, **more: Any) -> None:
        _check_closed(source)
        if os.path.lexists(target):
            if not replaces:
                raise FileExistsError(17, "Cannot create a file that exists", str(target))
            if os.path.isdir(target):
                raise PermissionError(13, "Access is denied", str(target))
            _check_closed(target)
        real(source, target, **more)

    return rename


def _filelock_as_on_windows() -> None:
    """Let filelock go on with the functions of POSIX, and remove its file once it is unlocked."""
    lock_class: Any = importlib.import_module("filelock").UnixFileLock
    posix = types.SimpleNamespace(**vars(os))
    modules: Any = sys.modules
    for name in [*modules]:
        if name.startswith("filelock.") and hasattr(modules[name], "os"):
            modules[name].os = posix
    unlock = lock_class._release

    def release(lock: Any) -> None:
        unlock(lock)
        Path(lock.lock_file).unlink(missing_ok=True)

    lock_class._release = release


def pretend() -> None:
    """Make this process behave like one on Windows."""
    for name in LIBRARIES:
        importlib.import_module(name)
    known: Any = sys.modules
    _filelock_as_on_windows()
    for name in MODULES:
        known[name] = None
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL)):
        for name in names:
            delattr(module, name)
    system: Any = os
    system.unlink = system.remove = _removing(os.unlink)
    system.rmdir = _removing(os.rmdir)
    system.rename, system.replace = _renaming(os.rename, False), _renaming(os.replace, True)
    plain: Any = shutil
    plain._use_fd_functions = False
    loads = ctypes.CDLL

    def load(name: Any, *rest: Any, **more: Any) -> Any:
        if name is None:
            raise TypeError("argument of type 'NoneType' is not iterable")
        return loads(name, *rest, **more)

    library: Any = ctypes
    library.CDLL = load
    known["sys"].platform = "win32"


def main(folder: str) -> None:
    """Write every kind of output, and replace it."""
    pretend()
    from lightmatrix.cli import main as run
    from lightmatrix.simulation.procedural import ProceduralScene

    os.chdir(folder)
    for seed in range(2):
        scene = ProceduralScene((8, 8), (8, 8), seed)
        scene.truth().save(Path(f"{seed}.npz"))
    Path("out").mkdir()  # An empty folder may be replaced.
    for more in ("", " --overwrite"):
        for line in (
            f"patterns bernoulli -k 8 --size 8 -o out{more}",
            f"simulate {int(bool(more))}.npz --patterns out -o captured{more}",
            f"estimate captured -o scene.zarr --no-coherent --no-check{more}",
            f"pack captured -o captured.zarr{more}",
            f"relight scene.zarr out/pattern_0000.png -o relit.tiff{more}",
            f"export scene.zarr T.npz{more}",
            "info scene.zarr --json",
        ):
            code = run(line.split())
            assert code == 0, f"{line}: exit code {code}"
    assert run(["export", "scene.zarr", "T.npz"]) == 2
    left = [path.name for path in Path().iterdir() if path.name.startswith(".")]
    assert not left, left


def test(*words: str) -> int:
    """Run pytest, without its own code for Windows."""
    import hypothesis.extra.numpy
    import pytest

    loaded = [hypothesis.extra.numpy, importlib.import_module("skimage")]
    pretend()
    assert loaded
    plain = ["--capture=sys", "-W", "ignore", "-o", "filterwarnings=", "-p", "no:cacheprovider"]
    return int(pytest.main([*plain, *words]))


if __name__ == "__main__":
    if sys.argv[1] == "pytest":
        sys.exit(test(*sys.argv[2:]))
    main(sys.argv[1])
