"""The scaling plot of the solver benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def scaling(table: list[dict[str, Any]], by_rows: list[dict[str, Any]], folder: Path) -> None:
    """Plot the cost of a row against N and K, with lines proportional to N, and against rows."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for count in sorted({row["patterns"] for row in table}):
        rows = [row for row in table if row["patterns"] == count]
        pixels = [row["size"] ** 2 for row in rows]
        cost = [row["microseconds_per_row"] for row in rows]
        (line,) = left.loglog(pixels, cost, "o-", label=f"K = {count:,}")
        left.loglog(
            pixels, [cost[-1] * n / pixels[-1] for n in pixels], ":", color=line.get_color()
        )
    left.set(xlabel="projector pixels N", ylabel="µs per row, one core")
    left.legend(title="dotted: proportional to N")
    costs = [row["microseconds_per_row"] for row in by_rows]
    right.semilogx([row["rows"] for row in by_rows], costs, "o-")
    first = by_rows[0]
    right.set(
        xlabel=f"rows (N = {first['size'] ** 2:,}, K = {first['patterns']})",
        ylabel="µs per row, one core",
        ylim=(0, 1.2 * max(costs)),
    )
    for kind in ("png", "svg"):
        figure.savefig(folder / f"scaling.{kind}", dpi=150)
