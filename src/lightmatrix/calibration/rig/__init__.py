"""The geometry of a rig, measured: from photographs of a board, or from any scene."""
