"""A motion: samples of all joints, in one place."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb


def test_a_motion_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="qd has shape"):
        tb.Motion(np.zeros(3), np.zeros((3, 2)), np.zeros((3, 1)), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="q has shape"):
        tb.Motion(np.zeros(3), np.zeros(()), np.zeros((3, 1)), np.zeros((3, 1)))


def test_a_slice_of_a_motion_is_the_same_slice_of_everything() -> None:
    rng = np.random.default_rng(0)
    whole = tb.Motion(np.arange(10.0), *rng.normal(size=(3, 10, 2)))
    part = whole[3:7]
    assert (whole.samples, part.samples) == (10, 4)
    for name in ("t", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[3:7])
