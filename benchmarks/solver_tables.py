"""Tables of the solver benchmarks on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

Row = dict[str, Any]


def show(console: Console, title: str, rows: list[Row], names: dict[str, str]) -> None:
    """Print a table; `names` maps the keys to show to their headings."""
    table = Table(title=title, title_justify="left")
    for key, heading in names.items():
        text = any(isinstance(row.get(key), str) for row in rows)
        table.add_column(heading, justify="left" if text else "right")
    for row in rows:
        table.add_row(*(_cell(row.get(key, "")) for key in names))
    console.print(table)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


FRAMES = {
    "scene": "scene",
    "patterns": "K",
    "regularization": "lambda",
    "seconds": "s",
    "sgemm_seconds": "one SGEMM, s",
    "ratio": "ratio",
    "microseconds_per_row": "one core, µs per row",
    "core_ratio": "ratio",
    "certified": "certified",
    "worst_gap": "worst gap",
    "passes": "passes",
    "support": "support",
    "clipped": "clipped",
}
AGREEMENT = {
    "scene": "scene",
    "rows": "rows",
    "beyond_certified_gap": "beyond certified gap",
    "objective_difference_at_1e-6": "difference at 1e-6",
    "reference_gap": "gap of the reference",
}
ADMM = {
    "scene": "scene",
    "patterns": "K",
    "rows": "rows",
    "microseconds_per_row": "active set, µs per row",
    "admm_iterations": "ADMM iterations",
    "admm_microseconds_per_row": "ADMM, µs per row",
    "admm_above_optimum": "above optimum",
    "times_faster": "times",
}
PASSES = {
    "patterns": "K",
    "kernel": "kernel",
    "microseconds_per_row": "µs per row",
    "sgemm_microseconds_per_row": "SGEMM, µs per row",
    "times_sgemm": "times SGEMM",
}
PEERS = {
    "patterns": "K",
    "name": "method",
    "setting": "its setting",
    "microseconds_per_row": "µs per row",
    "worst_gap": "worst gap",
    "objective": "mean objective",
    "times_active_set": "times active set",
    "note": "",
}
SCALING = {
    "size": "side",
    "patterns": "K",
    "rows": "rows",
    "microseconds_per_row": "µs per row",
    "nanoseconds_per_pattern_pixel": "ns / (K N)",
    "certified": "certified",
}
CLAIMS = {"claim": "claim", "measured": "measured", "limit": "limit", "verdict": ""}
