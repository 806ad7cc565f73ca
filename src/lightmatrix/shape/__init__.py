"""Shape: the rig's geometry is calibrated, stripes are decoded, and depth is triangulated."""
