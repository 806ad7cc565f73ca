"""Test a wheel for 64-bit ARM on another processor: qemu runs it, and the results must agree.

    python tools/wheel_arm64.py dist/arm64 [--folder target/arm64]

The first argument is a wheel for aarch64, or a folder that holds one (`make wheel-arm64`). An arm64
Python comes from Debian's archive, through a separate apt that installs nothing on this system; the
dependencies come from PyPI as arm64 wheels. This Python and the emulated one then make the same
small estimates, which takes minutes. Needs apt-get, dpkg-deb and qemu-aarch64 (qemu-user). On a
machine with such a processor, `make wheel-test` tests more.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# Estimates that use all kernels of the core: Bernoulli bits and grey patterns, rows with their
# neighbours and by themselves.
QUESTION = """
import platform, sys
import numpy as np
import lightmatrix as lm
print(platform.machine(), "Python", platform.python_version(), "NumPy", np.__version__)
patterns = lm.BernoulliPatterns((64, 64), 16)
capture = lm.simulate("metal", patterns, exposure=0.5, noise=0.003)
# With fewer patterns, a row by itself has many equally good solutions.
many = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 128), exposure=0.5, noise=0.003)
grey = lm.ImagePatterns(np.random.default_rng(0).random((16, 64, 64)).astype(np.float32))
other = lm.simulate("metal", grey, exposure=0.5, noise=0.003)
transports = {
    "coherent": lm.estimate(capture),
    "by rows": lm.estimate(many, coherent=False),
    "grey, by rows": lm.estimate(other, coherent=False),
}
images = {}
for name, transport in transports.items():
    error = lm.evaluate(transport, capture.truth).relative_error
    print(f"{name}: relative error {error:.9f}", flush=True)
    images[name] = transport.relight(np.eye(64, dtype=np.float32))
    images[name + ", dual"] = transport.dual(np.eye(64))
np.savez(sys.argv[1], **images)
"""
# Debian's package of the oldest Python that we support, and the libraries that wheels link to.
DEBIAN = "deb [signed-by={key}] http://deb.debian.org/debian bookworm main"
KEY = "/usr/share/keyrings/debian-archive-keyring.gpg"
PACKAGES = ("python3.11", "libstdc++6", "libgomp1")
# Results may differ by this share of the largest value, since float32 sums run in another order.
AGREE = 1e-4


def fetch_root(folder: Path) -> Path:
    """A folder with an arm64 Python, which apt downloads without installing it."""
    root, apt = folder / "root", folder / "apt"
    if (root / "usr/bin/python3.11").exists():
        return root
    for place in ("state/lists/partial", "cache/archives/partial"):
        (apt / place).mkdir(parents=True, exist_ok=True)
    (apt / "sources.list").write_text(DEBIAN.format(key=KEY) + "\n")
    (apt / "status").touch()
    (apt / "apt.conf").write_text(
        'APT::Architecture "arm64";\nAPT::Architectures { "arm64"; };\n'
        f'Dir::Etc::SourceList "{apt}/sources.list";\nDir::Etc::SourceParts "/dev/null";\n'
        f'Dir::State "{apt}/state";\nDir::State::status "{apt}/status";\n'
        f'Dir::Cache "{apt}/cache";\nAPT::Install-Recommends "false";\n'
    )
    environment = {**os.environ, "APT_CONFIG": str(apt / "apt.conf")}
    for words in (["update"], ["install", "--download-only", "--yes", *PACKAGES]):
        subprocess.run(["apt-get", "-qq", *words], check=True, env=environment)
    for package in sorted((apt / "cache/archives").glob("*.deb")):
        subprocess.run(["dpkg-deb", "--extract", package, root], check=True)
    return root


def install(folder: Path, version: str, platforms: Sequence[str], *packages: str | Path) -> Path:
    """Install packages and their dependencies for another system into a separate folder."""
    site = folder / "site"
    shutil.rmtree(site, ignore_errors=True)
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
         "--only-binary=:all:", f"--python-version={version}", "--implementation=cp",
         *(f"--platform={platform}" for platform in platforms), f"--target={site}",
         *map(str, packages)],
        check=True,
    )  # fmt: skip
    return site


def main() -> None:
    """Read the arguments and try the wheel."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="a wheel for aarch64, or a folder with one")
    parser.add_argument(
        "--folder", type=Path, default=Path("target/arm64"), help="kept between runs"
    )
    arguments = parser.parse_args()
    for command in ("apt-get", "dpkg-deb", "qemu-aarch64"):
        if shutil.which(command) is None:
            sys.exit(f"{command} is missing: this needs a Debian with the package qemu-user")
    wheels = sorted(arguments.wheel.glob("*aarch64.whl")) or [arguments.wheel]
    folder = arguments.folder.absolute()
    platforms = [f"manylinux_{name}_aarch64" for name in ("2_28", "2_27", "2_17")]
    root, site = fetch_root(folder), install(folder, "3.11", platforms, wheels[-1])
    # A variable may ask BLAS for a kernel that the other processor lacks.
    kept = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    emulated = ["qemu-aarch64", "-L", str(root), str(root / "usr/bin/python3.11")]
    environment = {**kept, "PYTHONPATH": str(site)}
    subprocess.run([*emulated, "-m", "lightmatrix", "--version"], check=True, env=environment)
    results = [folder / "results-here.npz", folder / "results-there.npz"]
    for file, python, own in zip(
        results, ([sys.executable], emulated), (kept, environment), strict=True
    ):
        subprocess.run([*python, "-c", QUESTION, str(file)], check=True, env=own)
    compare(results[0], results[1], "arm64")


def compare(here: Path, there: Path, system: str) -> None:
    """Compare the results of QUESTION on another system with those of this one."""
    elsewhere: dict[str, NDArray[np.floating]] = dict(np.load(there))
    for name, image in np.load(here).items():
        difference = float(np.abs(image - elsewhere[name]).max() / np.abs(image).max())
        print(f"{name}: differs by {difference:.1e} of the largest value")
        if difference > AGREE:
            sys.exit(f"{name}: the results on {system} differ")


if __name__ == "__main__":
    main()
