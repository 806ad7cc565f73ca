"""Run the examples and copy their pictures into the gallery.

python tools/gallery.py
"""

from __future__ import annotations

import runpy
import shutil
import tempfile
from pathlib import Path

from docs_site import EXAMPLES, GALLERY, GALLERY_FOLDER, ROOT, pictures_of


def main() -> None:
    """Make all pictures again."""
    folder = ROOT / "docs" / GALLERY_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name in GALLERY:
        with tempfile.TemporaryDirectory() as place:
            runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](Path(place))
            for picture in pictures_of(name):
                shutil.copy(Path(place) / picture, folder / f"{name}-{picture}")


if __name__ == "__main__":
    main()
