"""The benchmark measures itself against BLAS at its best."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from benchmarks import blas

ASKED = """
import os
from benchmarks import blas
print(sorted(set(blas.SETTINGS) & set(os.environ)), flush=True)
blas.at_its_best()
print("end")
"""


def test_a_program_begins_anew_without_settings_of_old_kernels(tmp_path: Path) -> None:
    script = tmp_path / "asked.py"
    script.write_text(ASKED)
    root = str(Path(__file__).parents[2])
    told = {**os.environ, "OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_L2_SIZE": "512"}
    told["PYTHONPATH"] = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(script)], env=told, capture_output=True, text=True, check=True
    )
    assert done.stdout.split("\n") == [
        "['OPENBLAS_CORETYPE', 'OPENBLAS_L2_SIZE']",
        "[]",
        "end",
        "",
    ]


def test_the_kernel_is_told() -> None:
    assert blas.told()
    assert blas.without_settings({"OPENBLAS_CORETYPE": "Haswell", "HOME": "/"}) == {"HOME": "/"}
