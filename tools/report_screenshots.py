"""Make the screenshots of the demo's report for the docs: on a wide screen and on a phone.

python tools/report_screenshots.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from browser import opened
from PIL import Image

import lightmatrix as lm

IMAGES = Path(__file__).parent.parent / "docs" / "images"
# Widths of the window, with the height of the part of the page that is shown.
WINDOWS = {1440: 1150, 360: 1100}


def main() -> None:
    """Run the demo and take screenshots of its report."""
    with tempfile.TemporaryDirectory() as place, opened() as browser:
        lm.demo(Path(place) / "report")
        for width, height in WINDOWS.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto((Path(place) / "report" / "report.html").as_uri())
            file = IMAGES / f"report-{width}.png"
            page.screenshot(path=file)
            # 256 colours halve the file.
            Image.open(file).quantize(256).save(file, optimize=True)
            page.close()


if __name__ == "__main__":
    main()
