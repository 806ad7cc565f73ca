"""Statistics of each scene's matrix, the table of docs/simulation.md, and a picture of all scenes.

    python benchmarks/scene_statistics.py [--size 64] [-o statistics.json] [--picture scenes.png]

Bundled scenes have 64 x 64 pixels; others are rendered at 16,384 paths per pixel and cached.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from experiments.fig5 import EXPOSURES, statistics
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.pictures.style import display, figure, panel, save
from lightmatrix.simulation import library
from lightmatrix.simulation.irradiance import irradiance
from lightmatrix.simulation.scenes import names
from lightmatrix.simulation.thumbnails import white_image, white_level


def table(rows: list[dict[str, Any]]) -> str:
    head = ["scene", "direct", "entries 90 %", "entries 99 %", "diffuse rows"]
    head += [f"clipped at {exposure:g}" for exposure in EXPOSURES]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [
            row["scene"],
            f"{row['direct_share']:.1%}",
            f"{row['entries_90']:.0f}",
            f"{row['entries_99']:.0f}",
            f"{row['diffuse_rows']:.1%}",
            *(f"{share:.1%}" for share in row["clipped_share"]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(path: Path) -> None:
    columns = (len(names()) + 1) // 2
    with figure(2.2 * columns, 4.8) as drawing:
        places = list(drawing.subplots(2, columns).flat)
        for axes in places[len(names()) :]:
            axes.axis("off")
        for axes, name in zip(places, names(), strict=False):
            image = white_image(name, (320, 320), samples=256)
            panel(axes, display(image, white_level(image)))
            axes.set_xlabel(name)
        save(drawing, path.parent, path.stem)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--scenes", nargs="+", default=list(names()))
    parser.add_argument("--picture", type=Path, help="also draw all scenes")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows = []
    for name in options.scenes:
        truth = library.truth(name, (options.size, options.size))
        started = time.perf_counter()
        irradiance(truth.matrix, BernoulliPatterns(truth.projector_shape, 1024))
        rows.append(
            {
                **statistics(name, truth),
                "entries_mean": truth.matrix.nnz / truth.matrix.shape[0],
                "noise_entries": truth.metadata["noise_entries"],
                "noise_white": truth.metadata["noise_white"],
                "samples": truth.metadata["samples"],
                "render_seconds": truth.metadata["seconds"],
                "simulate_1024_seconds": time.perf_counter() - started,
            }
        )
    print(table(rows))
    print("\n| scene | entries a row | noise of the entries | of the white image | K = 1,024 |")
    print("|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['scene']} | {row['entries_mean']:.0f} | {row['noise_entries']:.2%} | "
            f"{row['noise_white']:.2%} | {row['simulate_1024_seconds']:.1f} s |"
        )
    if options.output:
        summary = {"size": options.size, "exposures": EXPOSURES, "rows": rows}
        options.output.write_text(json.dumps(summary, indent=2) + "\n")
    if options.picture:
        draw(options.picture)


if __name__ == "__main__":
    main()
