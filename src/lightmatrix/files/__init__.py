"""File formats, and outputs that are written whole or not at all.

`writing.py` owns the second: locks, temporary names, what may be replaced. `running.py` keeps the
results of interrupted work.
"""
