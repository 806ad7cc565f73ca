"""What to photograph, and the error to expect."""
