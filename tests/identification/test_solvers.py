"""Equations that hardly determine their unknowns are solved or refused, never a fault."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from testbed.errors import UnseenParameters
from testbed.identification.solvers.normal import by_normal_equations


def test_sums_as_near_to_singular_as_rounding_tells_are_refused_by_name() -> None:
    rng, refused = np.random.default_rng(0), 0
    for _ in range(300):
        columns = rng.normal(size=(60, 30))
        columns[:, -1] = columns[:, :-1] @ rng.normal(size=29)
        columns[:, -1] += 10 ** rng.uniform(-8, -4) * rng.normal(size=60)
        equations: Any = SimpleNamespace(
            matrix=lambda weights, x=columns: x.T @ x,
            vector=lambda weights, x=columns: x.T @ np.ones(60),
            unknowns=tuple(f"p{k}" for k in range(30)),
            used=np.array([60.0]),
        )
        try:
            found = by_normal_equations(equations, np.eye(1), lambda combined: iter(()))
        except UnseenParameters as error:
            refused += error.rank < 30
        else:
            assert np.isfinite(found.values).all()
    assert 0 < refused < 300
