"""BLAS threads of this process."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which NumPy and SciPy multiply matrices on one thread.

    For many small products: more threads would mostly wait for each other, which took half of the
    processor time of `check` on two cores.
    """
    controller = ThreadpoolController().select(user_api="blas")
    if all(library["num_threads"] == 1 for library in controller.info()):
        # Setting what is set would start threads, and take memory, in a forked process.
        return nullcontext()
    limited: AbstractContextManager[object] = controller.limit(limits=1)
    return limited
