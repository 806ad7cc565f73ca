"""The camera: from light to raw levels, and back to linear samples."""
