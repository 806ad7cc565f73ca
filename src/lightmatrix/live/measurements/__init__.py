"""What is measured of a rig before a capture: one file for each quantity; rig.json keeps them."""
