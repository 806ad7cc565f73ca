"""Estimates by several processes, here or on other machines, on Dask's scheduler (extra cluster).

- `startup.py` starts workers, or connects to those of a cluster, and checks them.
- `pool.py` hands out tiles.
- `worker.py` runs in a worker: it solves a tile and writes it.
- `pickling.py` turns an estimate into bytes and back.
- `preload.py` is the hook that Dask runs as a worker starts.
"""
