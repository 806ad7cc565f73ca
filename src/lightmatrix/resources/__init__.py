"""What this machine offers: memory, disk space, temporary arrays."""
