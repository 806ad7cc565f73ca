"""`lm.export_viewer`: the viewer with one matrix as one file, which needs no server."""

import base64
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from lightmatrix.capture.capture import Capture
from lightmatrix.errors import InputError
from lightmatrix.files.kinds import PAGE
from lightmatrix.files.writing import atomic_file, check_output
from lightmatrix.geometry.rig_geometry import RigGeometry
from lightmatrix.transport.matrix import LightTransport
from lightmatrix.viewer.layers import page_size
from lightmatrix.viewer.scene import ViewedScene, opened

STYLE = "viewer.css"
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
    # Within HTML, no text of the script may end or open a script element.
    script = re.sub(r"<(?=/?script|!--)", r"\\x3c", bundle("page.js"), flags=re.IGNORECASE)
    return environment.from_string(page_file("viewer.html")).render(
        title=title, inline=data is not None, data=data or {}, style=Markup(page_file(STYLE)),
        script=Markup(script),
    )  # fmt: skip


# The largest matrix that goes into a page. As text it takes a third more, which can still be mailed
# and which a phone can still open.
_MOST_BYTES = 32 << 20


def export_viewer(
    path: str | Path,
    transport: LightTransport | str | Path,
    *,
    capture: Capture | str | Path | None = None,
    geometry: RigGeometry | str | Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write the viewer and one light transport matrix as one page, to send or to publish.

    The page needs neither a server nor the network.

    Parameters
    ----------
    path : str or Path
        The file to write, .html.
    transport : LightTransport, str or Path
        T, or where `open` finds it; at most 32 MiB as the page takes it: 4 bytes an entry, and 2
        for each value of the background.
    capture : Capture, str or Path, optional
        The capture that T was estimated from. The page then offers its patterns, a byte a pixel,
        which count towards the 32 MiB.
    geometry : RigGeometry, str or Path, optional
        The geometry of the rig, from `calibrate`. The page then has layers of depth.
    overwrite : bool
        Whether an existing page of the viewer may be replaced.

    Raises
    ------
    InputError
        If there is no such matrix, or it is too large for a page.
    OutputError
        If the file exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.export_viewer("metal.html", lm.truth("metal").transport())
    """
    check_output(path, PAGE, overwrite=overwrite)
    matrix = opened(transport, _MOST_BYTES)
    name = Path(transport).name if isinstance(transport, str | Path) else "the matrix"
    if page_size(matrix) > _MOST_BYTES:
        raise InputError(
            f"{name}: takes {page_size(matrix) / 2**20:.0f} MiB in a page",
            hint=f"at most {_MOST_BYTES >> 20} MiB fit: serve it (`serve_viewer`), crop it with "
            "LightTransport.crop, or estimate it with a larger bin_projector or bin_camera",
        )
    scene = ViewedScene(transport, capture=capture, geometry=geometry)
    size = page_size(matrix) + scene.pattern_count * matrix.shape[1]
    if size > _MOST_BYTES:
        raise InputError(
            f"{name} and {scene.pattern_count} patterns: {size / 2**20:.0f} MiB in a page",
            hint=f"at most {_MOST_BYTES >> 20} MiB fit: write the page without the capture",
        )
    parts = {"matrix": scene.matrix_bytes}
    parts |= {f"frame-{k}": scene.pattern(k) for k in range(scene.pattern_count)}
    for name in list(scene.layers.available):
        try:
            parts[f"layer-{name}"] = scene.layers.get(name)
        except InputError:
            # T may turn out to have none, such as one with too little direct light.
            del scene.layers.available[name]
    parts["scene"] = scene.description
    data = {name: base64.b64encode(part).decode() for name, part in parts.items()}
    with atomic_file(path, PAGE, overwrite=overwrite) as part:
        part.write_text(frame(scene.title, data), encoding="utf-8")
