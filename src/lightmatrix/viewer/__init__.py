"""A viewer in the browser: paint on the projector, and see what the camera would photograph.

- `page/`: the page, one ES module, its style and its frame. It needs no network and no build.
- `packed.py`: the format in which numbers travel to the page.
- `matrix_data.py`: T in that format, column by column.
- `layers.py`: maps and images that the page shows beside the relit image.
- `scene.py`: one matrix that is being viewed, and whether its store is still there.
- `guard.py`: who may connect.
- `answers.py`, `server.py`: what the server answers, and how it starts and ends.
- `export.py`: the page as one file.
"""
