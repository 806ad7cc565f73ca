"""Make the screenshots of the demo's report for the docs: on a wide screen and on a phone.

python tools/report_screenshots.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from browser import opened

import lightmatrix as lm

IMAGES = Path(__file__).parent.parent / "docs" / "images"
# Widths of the window, with the height of the part of the page that is shown.
WINDOWS = {1440: 2300, 360: 1500}


def main() -> None:
    """Run the demo and take screenshots of its report."""
    with tempfile.TemporaryDirectory() as place, opened() as browser:
        lm.demo(Path(place) / "report")
        for width, height in WINDOWS.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto((Path(place) / "report" / "report.html").as_uri())
            page.screenshot(path=IMAGES / f"report-{width}.png")
            page.close()


if __name__ == "__main__":
    main()
