"""Pictures of a light transport matrix and of its diagnostics."""
