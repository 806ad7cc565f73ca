"""The page itself: sections laid out as HTML that needs no network and no script."""

from __future__ import annotations

import re
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from lightmatrix.evaluation.verdict import Verdict
from lightmatrix.report.elements import Section, Strip


@dataclass(frozen=True)
class Page:
    """All that stands on a report.

    Parameters
    ----------
    title : str
        What the report is about, such as the name of a store.
    verdict : Verdict
        What to think of it.
    numbers : mapping of str to str
        The few numbers of the first screen.
    findings : tuple of str
        What is wrong with the frames, and what to do about it.
    order : Strip
        The first patterns and photographs.
    sections : tuple of Section
    version : str
        Of lightmatrix.
    """

    title: str
    verdict: Verdict
    numbers: dict[str, str]
    findings: tuple[str, ...]
    order: Strip
    sections: tuple[Section, ...]
    version: str


def html(page: Page) -> str:
    """A page as one document of HTML, with everything inside."""
    environment = Environment(
        loader=PackageLoader("lightmatrix.report"),
        # Whatever a name or a value holds is text.
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _code
    return environment.get_template("report.html").render(page=page) + "\n"


def _code(text: str) -> Markup:
    """Text in which `words` between backticks are set as code, and no line begins with a %."""
    together = str(escape(text)).replace(" %", "\N{NO-BREAK SPACE}%")
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", together))
