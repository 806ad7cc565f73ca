"""What is wrong with a capture, told from its frames, and what to do about it."""
