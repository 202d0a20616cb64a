"""What Bartlett's weights hide of filtered white noise, against the sums themselves."""

from __future__ import annotations

import numpy as np
import pytest

from testbed.identification.covariance import ScoreSquares, bin_size, hidden
from testbed.identification.filters import row_weights


@pytest.mark.parametrize(("rate", "step"), [(200.0, 10), (150.0, 10), (1000.0, 100)])
def test_what_is_hidden_of_filtered_noise_is_given_back(rate: float, step: int) -> None:
    """Expected squares are those of all impulses: of each, the rows that it leaves."""
    weights, rows = row_weights(rate, 5.0), rate / step
    assert bin_size(rows) == 1
    whole = seen = 0.0
    for phase in range(step):
        response = weights[phase::step][:, None]
        squares = ScoreSquares(1, rows)
        squares.add(response)
        seen += float(squares.finish()[0, 0])
        whole += float(response.sum() ** 2)
    assert hidden(weights, step, rows) == pytest.approx(whole / seen, rel=1e-9)
    assert hidden(np.ones(1), step, rows) == 1.0
