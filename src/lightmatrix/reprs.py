"""Objects as text: in one line, as a table in a notebook, and as JSON."""

import base64
import html
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

# Characters of a value in one line; longer texts, such as a provenance, are cut.
_LONGEST = 60
# What a user wants to know of an estimate at first sight, besides the verdict.
_MAIN = (
    "camera",
    "crop",
    "projector",
    "entries_per_row",
    "background_share",
    "clipped_samples",
    "converged_rows",
    "gap_max",
    "estimator",
    "regularization",
)
# Keys that need more than spaces for their underscores. A label has at most 26 characters, which
# leaves room for its value on a terminal of 80 columns.
_LABELS = {
    "entries_per_row": "entries per row",
    "background_grid": "background cells",
    "background_share": "light in the background",
    "rows_half_clipped": "rows half clipped or more",
    "iterations_median": "iterations (median)",
    "gap_median": "duality gap (median)",
    "gap_max": "duality gap (largest)",
    "rows_searched_everywhere": "rows searched everywhere",
    "relative_error": "error of T",
    "relighting_error": "error of relit images",
    "response_rmse": "RMSE of single responses",
    "share_of_rows_unclipped_responses": "rows no single pixel clips",
    "relative_error_unclipped_responses": "error of T, these rows",
    "relighting_error_unclipped_responses": "relit images, these rows",
    "share_of_rows_diffuse": "diffuse rows",
    "relative_error_diffuse": "error of T, diffuse rows",
    "relighting_error_diffuse": "relit images, diffuse rows",
} | {
    f"{error}_{colour}": f"{colour}: {label}"
    for error, label in (("relative_error", "error of T"), ("relighting_error", "relit images"))
    for colour in ("red", "green", "blue")
}
# Values between 0 and 1 that are shown in per cent.
_SHARES = {
    "gap_median",
    "gap_max",
    "response_rmse",
    "background_share",
    "clipped_samples",
    "rows_half_clipped",
    "converged_rows",
    "rows_searched_everywhere",
    "share_of_rows_unclipped_responses",
    "share_of_rows_diffuse",
}


class ShortRepr:
    """A dataclass with ``repr=False``, shown in one line, with type and shape for arrays."""

    def __repr__(self) -> str:
        values = (f"{one.name}={_short(getattr(self, one.name))}" for one in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(values)})"


def html_table(title: str, rows: Mapping[str, Any], picture: bytes = b"") -> str:
    """Names and values as a small table of HTML, for ``_repr_html_``, below a PNG if given."""
    lines = "".join(
        f"<tr><td style='text-align:left'>{html.escape(name)}</td>"
        f"<td style='text-align:left'>{html.escape(shown_value(value))}</td></tr>"
        for name, value in rows.items()
    )
    caption = f"<b>{html.escape(title)}</b>"
    if picture:
        source = f"data:image/png;base64,{base64.b64encode(picture).decode()}"
        caption += f"<br><img alt='' width=256 src='{source}'>"
    return f"<table><caption>{caption}</caption><tbody>{lines}</tbody></table>"


def text_table(title: str, rows: Mapping[str, Any]) -> str:
    """Names and values as lines of text, for a ``__repr__`` of several lines."""
    width = max(map(len, rows), default=0)
    lines = [f"  {name:<{width}}  {shown_value(value)}" for name, value in rows.items()]
    return "\n".join([title, *lines])


def shown_value(value: Any) -> str:
    """A value as text, numbers with three digits."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def percent(share: float) -> str:
    """A share in per cent, rounded to two digits or to whole per cent."""
    value = 100 * share
    if 0 < value < 0.001:
        return "below 0.001 %"
    digits = "0" if value == 0 else f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"
    return f"{digits} %"


def amount(size: float) -> str:
    """A number of bytes of memory or disk space, such as 3.21 GiB or 160 MiB."""
    units = ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while size >= 1000 and len(units) > 1:
        size, units = size / 1024, units[1:]
    return f"{size:,.0f} {units[0]}" if size >= 100 else f"{size:.3g} {units[0]}"


def jsonable(value: Any) -> Any:
    """NumPy numbers and arrays as JSON can hold them; to be the ``default`` of ``json.dumps``."""
    return value.tolist() if hasattr(value, "tolist") else value


def _short(value: Any) -> str:
    if hasattr(value, "nnz") and hasattr(value, "shape"):
        return f"<{_size(value.shape)} {value.dtype}, {value.nnz} entries>"
    if hasattr(value, "dtype") and len(getattr(value, "shape", "")) > 0:
        return f"<{_size(value.shape)} {value.dtype}>"
    if isinstance(value, Mapping):
        return f"<{len(value)} entries>" if value else "{}"
    if isinstance(value, tuple):
        name = type(value).__name__ if hasattr(value, "_fields") else ""
        return f"{name}({', '.join(_short(item) for item in value)})"
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def labelled(values: Mapping[str, Any], *, main_only: bool = False) -> dict[str, Any]:
    """The values by labels, shares and errors in per cent; about ten lines if `main_only`."""
    keys = [key for key in _MAIN if key in values] if main_only else list(values)
    return {
        _LABELS.get(key, key.replace("_", " ")): percent(values[key])
        if key in _SHARES or key.startswith(("relative_error", "relighting_error"))
        else values[key]
        for key in keys
    }
