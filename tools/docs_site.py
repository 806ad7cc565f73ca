"""Pages of the documentation that are generated when the site is built.

`mkdocs.yml` names this file as a hook. The start page is the README. The pages of commands come
from the command line, the reference from the public names in `__init__.pyi`, and the gallery from
the examples and their pictures. Formulas become MathML, which browsers show without scripts.
"""

from __future__ import annotations

import ast
import dataclasses
import html
import inspect
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from command_pages import command_nav, command_pages
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import lightmatrix as lm

ROOT = Path(__file__).parent.parent
NAMES = ROOT / "src" / "lightmatrix" / "__init__.pyi"
EXAMPLES = ROOT / "examples"
# The examples of the gallery, in this order.
GALLERY = (
    "relight_and_dual",
    "correspondence",
    "direct_and_global",
    "few_patterns",
    "estimate_in_python",
    "own_photographs",
    "compensation",
    "two_projectors",
    "colour_compensation",
    "inverse_light",
    "spectrum",
    "painting",
    "shape",
    "self_calibration",
)
# The page of the viewer that the site has, and the scene that it shows.
VIEWER_PAGE, VIEWER_SCENE = "viewer/metal.html", "metal"
GALLERY_FOLDER = "images/gallery"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of the commands behind their overview (MkDocs calls it)."""
    for part in config.nav or []:
        for heading, pages in part.items():
            if isinstance(pages, list) and "commands.md" in pages:
                rest = [page for page in pages if page != "commands.md"]
                part[heading] = [{"Commands": command_nav()}, *rest]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages (MkDocs calls it)."""
    pages = {
        "index.md": start_page(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(),
        "gallery.md": gallery_page(),
        **command_pages(),
        **reference_pages(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, VIEWER_PAGE, content=viewer_page()))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Link the viewer's pages to one that can be tried (MkDocs calls it)."""
    link = f"[Paint in your browser]({VIEWER_PAGE}), without installing anything."
    if page.file.src_uri == "viewer.md":
        title, rest = markdown.split("\n", 1)
        return f"{title}\n\n{link}\n{rest}"
    return markdown


def viewer_page() -> str:
    """The viewer with a bundled scene, as one page."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        lm.export_viewer(page, lm.truth(VIEWER_SCENE).transport())
        return page.read_text(encoding="utf-8")


def on_page_content(text: str, **_: Any) -> str:
    """Turn formulas into MathML, and empty heads of tables into cells (MkDocs calls it)."""
    # A head without words says nothing to a blind reader.
    text = re.sub(r"<th([^>]*)></th>", r"<td\1></td>", text)
    inline = re.sub(
        r'<span class="arithmatex">\\\((.*?)\\\)</span>',
        lambda match: convert(html.unescape(match[1])),
        text,
        flags=re.DOTALL,
    )
    return re.sub(
        r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>',
        # Whoever has no mouse scrolls a long formula by the keyboard.
        lambda match: (
            '<p class="formula" tabindex="0">'
            f"{convert(html.unescape(match[1]), display='block')}</p>"
        ),
        inline,
        flags=re.DOTALL,
    )


def start_page() -> str:
    """The README, with links relative to the folder docs."""
    text = (ROOT / "README.md").read_text().replace("](docs/", "](")
    return re.sub(r"\[CITATION\.cff\]\(CITATION\.cff\)", "CITATION.cff", text)


def reference_pages() -> dict[str, str]:
    """The public names and the classes that they return, a page for each heading in the stub."""
    pages: dict[str, str] = {}
    shown: set[str] = set()
    parts = re.split(r"^# (.+)\.\n(?=from)", NAMES.read_text(), flags=re.MULTILINE)[1:]
    for heading, part in zip(parts[::2], parts[1::2], strict=True):
        lead = "`import lightmatrix as lm` has these names, without the classes of results."
        lines = [f"# {heading}", "", lead, ""]
        for node in ast.parse(part).body:
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    things = [f"{node.module}.{alias.name}"]
                    for each in returned_classes(getattr(lm, alias.name)):
                        things.append(f"{each.__module__}.{each.__name__}"[len("lightmatrix.") :])
                    for thing in things:
                        if thing not in shown:
                            lines += [f"::: lightmatrix.{thing}", ""]
                    shown.update(things)
        slug = re.sub(r"[^a-z]+", "-", heading.lower()).strip("-")
        pages[f"reference/{slug}.md"] = "\n".join(lines)
    return pages


def returned_classes(thing: object) -> list[type]:
    """The classes that a public name leads to, and which are no public names themselves.

    These are the classes in the return annotation of a function, and those that a class names in
    its docstring or annotations, such as the enumeration of one of its fields.
    """
    if inspect.isfunction(thing):
        texts = [(thing.__module__, str(thing.__annotations__.get("return")))]
    elif dataclasses.is_dataclass(thing):
        texts = [(thing.__module__, str(thing.__annotations__))]
    else:
        return []
    found: list[type] = []
    while texts:
        module, text = texts.pop()
        for name in re.findall(r"\w+", text):
            each = getattr(sys.modules[module], name, None)
            if not inspect.isclass(each) or each in found or name.startswith("_"):
                continue
            if each.__module__.startswith("lightmatrix.") and name not in dir(lm):
                found.append(each)
                texts.append((each.__module__, f"{each.__doc__} {each.__annotations__}"))
    return found


def gallery_page() -> str:
    """The examples: their subject, their pictures, and their code."""
    lead = "The tests run each of these scripts. `make gallery` makes the pictures."
    lines = ["# Gallery", "", lead, ""]
    for name in GALLERY:
        file = EXAMPLES / f"{name}.py"
        code = file.read_text()
        docstring = ast.get_docstring(ast.parse(code)) or name
        title, _, rest = docstring.partition("\n")
        lines += [f"## {title.rstrip('.')}", ""]
        lines += [_plain(re.sub(r"^ *python examples/.*$", "", rest, flags=re.MULTILINE)), ""]
        for picture, words in pictures_of(name).items():
            lines += [f"![{words}]({GALLERY_FOLDER}/{name}-{picture})", "", f"*{words}*", ""]
        if name == "painting":
            lines += [f"[Paint in your browser]({VIEWER_PAGE}).", ""]
        lines += [f"`python examples/{name}.py OUT_FOLDER`:", "", "```python"]
        lines += [code.split('"""', 2)[2].strip(), "```", ""]
    return "\n".join(lines)


def pictures_of(example: str) -> dict[str, str]:
    """The pictures that an example writes, each with its caption, from its constant PICTURES."""
    for node in ast.parse((EXAMPLES / f"{example}.py").read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PICTURES":
            captions: dict[str, str] = ast.literal_eval(node.value)
            return captions
    raise ValueError(f"{example}.py has no PICTURES")


def _plain(text: str) -> str:
    """Paragraphs of plain text."""
    return "\n\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))
