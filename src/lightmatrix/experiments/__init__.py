"""The demo, the paper's figures (one file each), and claims of our own."""
