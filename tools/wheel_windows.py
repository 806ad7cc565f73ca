"""Test the core and a wheel for Windows on Linux: Wine runs them, and the results must agree.

    python tools/wheel_windows.py dist/windows [--python FOLDER] [--folder target/windows]

The first argument is a wheel for win_amd64, or a folder that holds one (`make wheel-windows`). The
core's tests are compiled for Windows, and Wine runs them. `--python` is a folder with a CPython for
Windows, as in its NuGet package (python.exe, python3.dll). The wheel and its dependencies are then
installed beside it, and both Pythons make the same small estimates, which takes minutes. Needs Wine
and MinGW's compiler (on Debian: wine, gcc-mingw-w64-x86-64). On Windows itself,
`tools/wheel_test.py` tests more.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from wheel_arm64 import QUESTION, compare, install

TARGET = "x86_64-pc-windows-gnu"
COMPILER, OBJDUMP = "x86_64-w64-mingw32-gcc", "x86_64-w64-mingw32-objdump"
# Dependencies that are needed on Windows only, and that pip therefore skips on other systems.
ONLY_THERE = ("colorama", "tzdata")

# Source of bcryptprimitives.dll, which Wine has only from version 9 on.
RANDOM = """
#include <windows.h>
BOOLEAN NTAPI SystemFunction036(PVOID, ULONG);
__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE data, SIZE_T size) {
    return SystemFunction036(data, (ULONG)size);
}
"""
# Source of the functions of complex numbers that NumPy needs and Wine's C library lacks. Windows
# passes complex numbers as structures, and its long double is a double.
MATHEMATICS = "api-ms-win-crt-math-l1-1-0.dll"
STAND_IN = "instead-of-the-crt-math-l1.dll"
COMPLEX = """
#include <complex.h>
typedef struct { double v[2]; } D;
typedef struct { float v[2]; } F;
static double complex d(D x) { return __builtin_complex(x.v[0], x.v[1]); }
static float complex f(F x) { return __builtin_complex(x.v[0], x.v[1]); }
static D D_(double complex z) { return (D){{creal(z), cimag(z)}}; }
static F F_(float complex z) { return (F){{crealf(z), cimagf(z)}}; }
"""
_COMPLEX_NAME = re.compile(
    r"(c(?:abs|arg|real|imag|proj|pow|sqrt|exp|log|log10|conj|a?(?:sin|cos|tan)h?))([fl]?)"
)


def prefix(folder: Path) -> Path:
    """Set up Wine with the libraries that it lacks, and return the folder of its libraries."""
    system = folder / "prefix/drive_c/windows/system32"
    if not (system / "kernel32.dll").exists():
        for words in (["wineboot", "--init"], ["winecfg", "-v", "win10"]):
            wine(folder, *words)
    if not (system / "bcryptprimitives.dll").exists():
        _library(folder, system / "bcryptprimitives.dll", RANDOM, "-ladvapi32")
    return system


def wine(folder: Path, *words: str | Path) -> None:
    """Run a program for Windows."""
    # Pipes, because standard streams that are files or terminals confuse some versions of Wine.
    process = subprocess.Popen(
        ["wine", *map(str, words)], env=environment(folder), stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        print(line, end="", flush=True)
    if process.wait():
        sys.exit(f"{words[0]} failed on Wine with exit code {process.returncode}")


def environment(folder: Path) -> dict[str, str]:
    """The environment of Wine, without variables that lead to this system's packages."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("OPENBLAS", "PYTHON", "VIRTUAL_ENV"))
    }
    return {**kept, "WINEPREFIX": str(folder / "prefix"), "WINEDEBUG": "-all"}


def _library(folder: Path, file: Path, source: str, *more: str | Path) -> None:
    code = folder / f"{file.stem}.c"
    code.write_text(source)
    words = ["-shared", "-O2", "-static", "-static-libgcc", "-o", file, code, *more]
    subprocess.run([COMPILER, *map(str, words)], check=True)


def version_of(python: Path) -> str:
    """The version of a CPython for Windows, as 3.11."""
    versions = [n[6:-4] for n in os.listdir(python) if re.fullmatch(r"python3\d+\.dll", n)]
    if not versions:
        sys.exit(f"{python}: is no CPython for Windows, since it has no file such as python311.dll")
    return f"{versions[0][0]}.{versions[0][1:]}"


def mend_mathematics(site: Path, system: Path, folder: Path) -> None:
    """Redirect the libraries' mathematics to a library that has complex numbers too."""
    names: set[str] = set()
    for file in sorted(site.rglob("*")):
        if file.suffix not in (".pyd", ".dll") or MATHEMATICS.encode() not in file.read_bytes():
            continue
        names |= _imports(file)
        data = file.read_bytes()
        file.write_bytes(data.replace(MATHEMATICS.encode(), STAND_IN.encode()))
    lines, exports = [COMPLEX], ["EXPORTS"]
    for name in sorted(names):
        match = _COMPLEX_NAME.fullmatch(name)
        if match is None:
            exports.append(f"  {name}=ucrtbase.{name}")
            continue
        kind, value, real, suffix = ("F", "f", "float", "f") if match[2] == "f" else (
            "D", "d", "double", "")  # fmt: skip
        more = match[1] == "cpow"
        call = f"{match[1]}{suffix}({value}(x){f', {value}(y)' if more else ''})"
        takes = f"{kind} x{f', {kind} y' if more else ''}"
        if match[1] in ("cabs", "carg", "creal", "cimag"):
            lines.append(f"{real} own_{name}({takes}) {{ return {call}; }}")
        else:
            lines.append(f"{kind} own_{name}({takes}) {{ return {kind}_({call}); }}")
        exports.append(f"  {name}=own_{name}")
    definition = folder / "mathematics.def"
    definition.write_text("\n".join(exports) + "\n")
    _library(folder, system / STAND_IN, "\n".join(lines) + "\n", definition)


def _imports(file: Path) -> set[str]:
    """The names that a library imports from the C library's mathematics."""
    listed = subprocess.run([OBJDUMP, "-p", file], check=True, capture_output=True, text=True)
    names, within = set(), False
    for line in listed.stdout.splitlines():
        if "DLL Name:" in line:
            within = line.split()[-1] == MATHEMATICS
        elif not line.strip():
            within = False
        elif within and (match := re.fullmatch(r"\s+[0-9a-f]+\s+\d+\s+(\w+)", line)):
            names.add(match[1])
    return names


def main() -> None:
    """Read the arguments and try the core and the wheel."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="a wheel for win_amd64, or a folder with one")
    parser.add_argument("--python", type=Path, help="a folder with a CPython for Windows")
    parser.add_argument(
        "--folder", type=Path, default=Path("target/windows"), help="kept between runs"
    )
    arguments = parser.parse_args()
    for command in ("wine", COMPILER):
        if shutil.which(command) is None:
            sys.exit(f"{command} is missing: on Debian, install wine and gcc-mingw-w64-x86-64")
    wheels = sorted(arguments.wheel.glob("*win_amd64.whl")) or [arguments.wheel]
    folder = arguments.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    system = prefix(folder)
    runner = f"CARGO_TARGET_{TARGET.upper().replace('-', '_')}_RUNNER"
    subprocess.run(
        ["cargo", "test", "--quiet", "--package", "lightmatrix-core", "--profile", "quick",
         "--target", TARGET],
        check=True, env={**environment(folder), runner: "wine"}, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if arguments.python is None:
        print("no CPython for Windows (--python): the wheel was not tried")
        return
    version = version_of(arguments.python)
    site = install(folder, version, ["win_amd64"], wheels[-1], *ONLY_THERE)
    mend_mathematics(site, system, folder)
    question = folder / "question.py"
    question.write_text(f"import sys\nsys.path.insert(0, {f'Z:{site}'!r})\n{QUESTION}")
    there = folder / "results-there.npz"
    wine(folder, arguments.python / "python.exe", question, f"Z:{there}")
    here = folder / "results-here.npz"
    subprocess.run([sys.executable, "-c", QUESTION, str(here)], check=True)
    compare(here, there, "Windows")


if __name__ == "__main__":
    main()
