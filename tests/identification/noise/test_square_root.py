"""Square roots of covariances, singular ones too."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.identification.noise.scaled import square_root


@pytest.mark.parametrize("rank", [6, 5, 3])
def test_a_root_times_itself_is_the_matrix(rank: int) -> None:
    """Of unknowns of very different units; where rounding makes it singular, nearly so."""
    rng = np.random.default_rng(rank)
    half = rng.normal(size=(6, rank)) * np.logspace(-6, 6, 6)[:, None]
    matrix = half @ half.T
    root = square_root(matrix)
    scale = np.sqrt(np.diagonal(matrix))
    np.testing.assert_allclose(
        root @ root.T / np.outer(scale, scale), matrix / np.outer(scale, scale), atol=1e-12
    )
    assert np.linalg.matrix_rank(root / scale[:, None], tol=1e-9) <= 6


def test_a_matrix_that_rounding_made_negative_has_one() -> None:
    matrix = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-16]])
    matrix[1, 1] -= 3e-16
    assert np.isfinite(square_root(matrix)).all()
