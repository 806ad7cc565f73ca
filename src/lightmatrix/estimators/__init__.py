"""From a capture to a light transport matrix. Start at `estimate.py`."""
