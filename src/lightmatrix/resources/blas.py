"""BLAS threads of this process."""

from __future__ import annotations

from threadpoolctl import threadpool_limits


def one_blas_thread() -> threadpool_limits:
    """A context in which NumPy and SciPy multiply matrices on one thread.

    For many small products: more threads would mostly wait for each other, which took half of the
    processor time of `check` on two cores.
    """
    return threadpool_limits(limits=1, user_api="blas")
