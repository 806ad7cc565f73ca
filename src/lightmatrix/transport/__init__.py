"""The light transport matrix in memory and on disk, and the correspondence that it holds."""
