"""Estimates by several processes, here or on other machines, on Dask's scheduler (extra cluster).

`opening.py` starts or finds the workers and refuses those that would not do; `crew.py` hands out
tiles; `solving.py` is what a worker does with one; `travel.py` is how an estimate gets there.
"""
