"""The page's own files, and its frame."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

SCRIPT, STYLE = "viewer.js", "viewer.css"
_FRAME = "viewer.html"


@cache
def page_file(name: str) -> str:
    """The text of one of the page's files."""
    return files("lightmatrix.viewer").joinpath("page", name).read_text(encoding="utf-8")


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
        script=Markup(_without_end_tags(page_file(SCRIPT))),
    )
    return text


def _without_end_tags(script: str) -> str:
    """A script that can stand within HTML: no text of it ends or opens a script element."""
    return re.sub(r"<(?=/?script|!--)", r"\\x3c", script, flags=re.IGNORECASE)
