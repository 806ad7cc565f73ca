"""Write docs/settings.md from the solvers' and estimators' own parameters and docstrings.

python tools/settings_table.py          rewrite the page
python tools/settings_table.py --check  exit 1 if it is out of date
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
from pathlib import Path
from typing import Any

from lightmatrix import solvers
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator

PAGE = Path(__file__).parent.parent / "docs" / "settings.md"
ESTIMATORS = (PlainEstimator, CoherentEstimator)
HEAD = """# Settings of the solvers and estimators

Most users need none of these: the options of `lightmatrix estimate` choose them. Each section is a
class of `import lightmatrix as lm`. This page is generated: edit the docstrings, then run
`python tools/settings_table.py`.
"""


def page() -> str:
    """The whole page."""
    described = [
        value
        for name in solvers.__all__
        if dataclasses.is_dataclass(value := getattr(solvers, name))
    ]
    parts = [_section(one) for one in described if hasattr(one, "row_bytes")]
    return "\n".join([HEAD, *parts, *map(_section, ESTIMATORS)])


def _section(solver: Any) -> str:
    text = inspect.getdoc(solver) or ""
    meaning = _parameters(text)
    lines = [f"## {solver.__name__}", "", text.splitlines()[0], ""]
    lines += ["| setting | type | default | meaning |", "|---|---|---|---|"]
    for field in dataclasses.fields(solver):
        default = "required" if field.default is dataclasses.MISSING else f"`{field.default}`"
        # A module may hold its annotations as texts.
        stated: Any = field.type
        kind = stated if isinstance(stated, str) else inspect.formatannotation(stated)
        kind = re.sub(r"\w+\.", "", kind).replace("|", "or")
        lines.append(f"| `{field.name}` | {kind} | {default} | {meaning[field.name]} |")
    return "\n".join([*lines, ""])


def _parameters(text: str) -> dict[str, str]:
    """The parameters of a NumPy-style docstring with their meanings."""
    section = re.search(r"Parameters\n-+\n(.*?)(?:\n\n|\Z)", text, flags=re.DOTALL)
    entries = re.split(r"\n(?=\w)", section[1] if section else "")
    result = {}
    for entry in entries:
        head, _, body = entry.partition("\n")
        for name in head.split(":")[0].split(","):
            result[name.strip()] = " ".join(body.split()).replace("|", "\\|")
    return result


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(PAGE.read_text() != page())
    PAGE.write_text(page())
