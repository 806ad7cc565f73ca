"""Print the requirements of extras, one a line; to install them without a new build."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

if __name__ == "__main__":
    with (Path(__file__).parent.parent / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    extras = project["optional-dependencies"]
    print(*(line for extra in sys.argv[1:] for line in extras[extra]), sep="\n")
