"""Linear algebra on one thread: the order of its sums, and so their bits, depend on the number."""

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
    """Limit BLAS to one thread; also a decorator."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (m,), from the least, and eigenvectors in columns (m, m) of a symmetric matrix.

    NumPy's divide and conquer (LAPACK's syevd) gives up on a few good matrices of a hundred
    columns and more; relatively robust representations (syevr) then do it.

    Args:
        matrix: (m, m).
    """
    try:
        size, axes = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        size, axes = linalg.eigh(matrix, driver="evr")
    return size, axes
