"""A viewer in the browser: paint on the projector, and see what the camera would photograph.

- `page/`: the page, one ES module, its style and its frame. It needs no network and no build.
- `packed.py`: the format in which numbers travel to the page.
- `lights.py`: T as the page needs it, whole or averaged over blocks.
- `layers.py`: maps and images that the page shows beside the relit image.
- `scene.py`: one matrix that is being viewed.
- `session.py`: one window, what it asks for, and what is painted in it.
- `server.py`: who may connect, what the server answers, and how it starts and ends.
- `export.py`, `notebook.py`: the page as one file, and in a notebook.
"""
