"""Linear algebra on one thread, while that is asked for and no longer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from testbed.blas import one_blas_thread


def threads() -> list[int]:
    """Of each library that multiplies matrices."""
    found: list[dict[str, Any]] = threadpool_info()
    return [each["num_threads"] for each in found if each["user_api"] == "blas"]


def test_one_thread_is_used_meanwhile_and_as_many_as_before_afterwards() -> None:
    np.linalg.inv(np.eye(3))  # the library is there
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        if set(before) != {2}:
            pytest.skip("this library of linear algebra has one thread")
        with one_blas_thread():
            assert set(threads()) == {1}
        assert threads() == before
