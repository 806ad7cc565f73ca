"""The multi-scale estimate: projector blocks first, then the pixels that matter."""
