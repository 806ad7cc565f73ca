"""Files: images, outputs that are whole or absent, headers."""
