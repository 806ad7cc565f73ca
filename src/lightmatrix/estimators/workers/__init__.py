"""Estimates by several processes, here or on other machines, on Dask's scheduler (extra cluster).

- `pool.py` starts workers, or connects to those of a cluster, checks them, and hands out tiles.
- `worker.py` runs in a worker: it opens an estimate, solves a tile and writes it.
"""
