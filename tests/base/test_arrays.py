"""Arrays as values, and the two matrices that every room needs."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.arrays import apply, readonly, skew

SHAPES = [(), (4,), (2, 5), (2, 1, 3)]


@pytest.mark.parametrize("lead", SHAPES)
def test_skew_is_the_cross_product(lead: tuple[int, ...]) -> None:
    u, v = np.random.default_rng(0).normal(size=(2, *lead, 3))
    np.testing.assert_allclose(apply(skew(v), u), np.cross(v, u), atol=1e-15)
    assert skew(v).shape == (*lead, 3, 3)


@pytest.mark.parametrize("lead", SHAPES)
def test_apply_multiplies_sample_by_sample(lead: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    matrix, vector = rng.normal(size=(*lead, 3, 3)), rng.normal(size=(*lead, 3))
    expected = np.einsum("...ij,...j->...i", matrix, vector)
    np.testing.assert_allclose(apply(matrix, vector), expected, atol=1e-15)


def test_readonly_takes_what_numpy_takes_and_gives_floats_that_stay() -> None:
    found = readonly([[1, 2], [3, 4]], (2, None), "table")
    assert found.dtype == np.float64
    assert found.tolist() == [[1, 2], [3, 4]]
    assert not found.flags.writeable


def test_readonly_copies_what_others_may_write_to_and_nothing_else() -> None:
    loose = np.zeros(3)
    kept = readonly(loose, (3,), "v")
    loose[0] = 1.0
    assert kept[0] == 0.0
    assert loose.flags.writeable
    assert readonly(kept, (3,), "v") is kept
    assert np.shares_memory(readonly(kept[1:], (2,), "v"), kept)


@pytest.mark.parametrize("shape", [(2,), (3, 1), (1, 3), (), (4,)])
def test_a_wrong_shape_is_named_beside_the_one_that_is_wanted(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"^speed has shape \(.*\), expected \(3\)$"):
        readonly(np.zeros(shape), (3,), "speed")
    with pytest.raises(ValueError, match=r"expected \(any, 3, 3\)$"):
        readonly(np.zeros((2, 3, 4)), (None, 3, 3), "frames")
