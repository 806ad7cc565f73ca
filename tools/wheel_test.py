"""Test a wheel as a newcomer gets it: in an empty environment without a compiler, run the demo.

    python tools/wheel_test.py dist [--quick | --cpu Nehalem]

The first argument is a wheel, or a folder that holds one for this system. PATH holds only the new
environment, and pip takes no source packages. The installation must stay below MOST_MEGABYTES.
`--quick` skips compiling the modules to bytecode, which takes longest, and its megabytes. `--cpu`
also runs an estimate on an emulated processor of qemu-user; Nehalem is x86-64-v2, the oldest that
NumPy's wheels run on. Works without a shell on Linux, macOS and Windows.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

# The script for an emulated processor: it shows which kernels it has, and estimates once.
QUESTION = """
import lightmatrix as lm
patterns = lm.BernoulliPatterns((64, 64), 16)
patterns.prepare(None, "portable")
try:
    patterns.prepare(None, "avx2")
except Exception as refusal:
    print(refusal)
transport = lm.estimate(lm.simulate("metal", patterns), coherent=False, iterations=3)
print(transport)
"""
# The limit for the base install, in millions of bytes: without extras, and without the packages of
# an empty environment. It takes 485 today (docs/platforms.md); much more means a new dependency.
MOST_MEGABYTES = 500
# Variables that would lead to other code than the wheel's, or to kernels an emulated CPU lacks.
_FOREIGN = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "OPENBLAS_CORETYPE")


def find(place: Path) -> Path:
    """The wheel itself, or the newest one in a folder."""
    if place.is_file():
        return place
    wheels = sorted(place.glob("lightmatrix-*.whl"), key=lambda file: file.stat().st_mtime)
    if not wheels:
        sys.exit(f"{place}: holds no wheel of lightmatrix; make one with `make wheel`")
    return wheels[-1]


def try_wheel(wheel: Path, folder: Path, cpu: str | None, quick: bool) -> None:
    """Install a wheel into a new environment and run the demo from it."""
    place = folder / "environment"
    venv.create(place, with_pip=True)
    scripts = place / ("Scripts" if os.name == "nt" else "bin")
    kept = {name: value for name, value in os.environ.items() if name not in _FOREIGN}
    environment = {**kept, "PATH": str(scripts)}
    for compiler in ("cargo", "rustc", "gcc", "cc", "cl"):
        assert shutil.which(compiler, path=str(scripts)) is None

    def run(*words: str | Path) -> None:
        subprocess.run([str(word) for word in words], check=True, env=environment, cwd=folder)

    python = scripts / ("python.exe" if os.name == "nt" else "python")
    empty = _megabytes(place)
    options = ["--quiet", "--only-binary", ":all:", *(["--no-compile"] if quick else [])]
    run(python, "-m", "pip", "install", *options, wheel.absolute())
    size = _megabytes(place) - empty
    print(f"{wheel.name}: installed, {size:.0f} MB beside {empty:.0f} of the empty environment")
    if size > MOST_MEGABYTES:
        sys.exit(f"the base install takes {size:.0f} MB, more than {MOST_MEGABYTES}")
    started = time.perf_counter()
    run(scripts / "lightmatrix", "demo", "-o", "report")
    assert (folder / "report" / "report.html").stat().st_size > 100_000
    print(f"the demo ran in {time.perf_counter() - started:.0f} s")
    if cpu is not None:
        emulator = shutil.which("qemu-x86_64")
        if emulator is None:
            sys.exit("qemu-x86_64 is missing: install qemu-user")
        run(emulator, "-cpu", cpu, python, "-c", QUESTION)
        print(f"runs on {cpu}")


def _megabytes(folder: Path) -> float:
    """Size of the files in a folder, in millions of bytes."""
    files = (file for file in folder.rglob("*") if file.is_file() and not file.is_symlink())
    return sum(file.stat().st_size for file in files) / 1e6


def main() -> None:
    """Read the arguments and try the wheel."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path, help="a wheel, or a folder with one")
    parser.add_argument("--quick", action="store_true", help="compile no modules to bytecode")
    parser.add_argument("--cpu", help="a processor of qemu-user to emulate too")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try_wheel(find(arguments.wheel), Path(folder), arguments.cpu, arguments.quick)


if __name__ == "__main__":
    main()
