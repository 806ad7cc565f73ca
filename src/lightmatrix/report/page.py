"""The page of a report: sections laid out as HTML that needs no network and no script."""

from __future__ import annotations

import re
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from lightmatrix.evaluation.judgement import Verdicts
from lightmatrix.report.elements import Section, Strip


@dataclass(frozen=True)
class Page:
    """The content of a report."""

    title: str
    verdicts: Verdicts
    # The few numbers of the first screen.
    numbers: dict[str, str]
    # The viewer's page beside this one, if there is one.
    viewer: str | None
    # Problems of the frames, with remedies.
    findings: tuple[str, ...]
    first_frames: Strip
    sections: tuple[Section, ...]
    version: str


def html(page: Page) -> str:
    """A page as one self-contained HTML document."""
    environment = Environment(
        loader=PackageLoader("lightmatrix.report"),
        # Names and values are text, whatever they hold.
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _code
    return environment.get_template("report.html").render(page=page) + "\n"


def _code(text: str) -> Markup:
    """Escaped text with `words` in backticks as code, and no line break before a %."""
    together = str(escape(text)).replace(" %", "\N{NO-BREAK SPACE}%")
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", together))
