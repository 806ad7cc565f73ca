"""The coherent estimate: camera pixels learn from their neighbours where their light is."""
