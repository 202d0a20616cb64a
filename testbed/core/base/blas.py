"""Linear algebra on one thread, with reproducible results.

The order of summation in BLAS, and therefore the rounding, depends on the number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from scipy import linalg
from threadpoolctl import ThreadpoolController

from testbed.core.base.arrays import Array


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context manager or decorator that limits BLAS to one thread."""
    with _thread_controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _thread_controller() -> ThreadpoolController:
    """Controller of the threads of all loaded BLAS libraries."""
    return ThreadpoolController()


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues in ascending order, (m,), and eigenvectors, (m, m), of a symmetric matrix.

    Divide and conquer (LAPACK's syevd, the default of NumPy) fails to converge for a few regular
    matrices with a hundred or more columns. In this case, relatively robust representations (syevr)
    are used.

    Args:
        matrix: Symmetric matrix, (m, m).

    Returns:
        Eigenvalues and eigenvectors in columns.
    """
    try:
        eigenvalues, eigenvectors = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        eigenvalues, eigenvectors = linalg.eigh(matrix, driver="evr")
    return eigenvalues, eigenvectors
