"""What this machine has left: memory, disk space, and room for temporary arrays."""
