"""The light transport matrix in memory, and how far an estimate is from the truth."""
