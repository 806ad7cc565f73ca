"""The correspondence of a capture under stripes: Gray code, phase shifts, any code of its kind."""
