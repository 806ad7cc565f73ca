"""The page's own files, its frame, and its modules as one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

SCRIPT, STYLE = "page.js", "viewer.css"
_FRAME = "viewer.html"
# How our modules import from each other: a line each.
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./(\w+\.js)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=const|class|function|async function)", re.MULTILINE)


@cache
def page_file(name: str) -> str:
    """The text of one of the page's files."""
    return files("lightmatrix.viewer").joinpath("page", name).read_text(encoding="utf-8")


@cache
def module_names() -> frozenset[str]:
    """The names of the page's modules."""
    folder = files("lightmatrix.viewer").joinpath("page")
    return frozenset(file.name for file in folder.iterdir() if file.name.endswith(".js"))


@cache
def bundle(entry: str) -> str:
    """A module and all that it imports as one module, which imports nothing.

    The modules follow each other without their lines of `import` and `export`. Their names do not
    collide; a browser would refuse the bundle otherwise.
    """
    ordered: dict[str, str] = {}

    def add(name: str) -> None:
        text = page_file(name)
        for imported in _IMPORT.findall(text):
            if imported not in ordered:
                add(imported)
        ordered[name] = _EXPORT.sub("", _IMPORT.sub("", text))

    add(entry)
    return "\n".join(ordered.values())


def frame(title: str, data: Mapping[str, str] | None = None) -> str:
    """The HTML of the page. With data, in base64 by name, it holds all that it needs."""
    # Titles are text, whatever they hold.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = environment.from_string(page_file(_FRAME)).render(
        title=title,
        inline=data is not None,
        data=data or {},
        style=Markup(page_file(STYLE)),
        script=Markup(_without_end_tags(bundle(SCRIPT))),
    )
    return text


def _without_end_tags(script: str) -> str:
    """A script that can stand within HTML: no text of it ends or opens a script element."""
    return re.sub(r"<(?=/?script|!--)", r"\\x3c", script, flags=re.IGNORECASE)
