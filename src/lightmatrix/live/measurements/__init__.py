"""What is measured of a rig before anything is photographed: each in one file, kept in rig.json."""
