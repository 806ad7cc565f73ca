"""File formats: images and stacks of them, NumPy's files, our JSON files, arrays of Zarr."""
