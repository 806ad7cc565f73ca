"""The light transport matrix in memory, and the correspondence that it holds."""
