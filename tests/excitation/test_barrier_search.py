"""The search ends where SciPy's does, and every point on its way is inside."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.optimize import minimize

from testbed.arrays import Array
from testbed.excitation.barrier_search import Inside, Point, minimise


@dataclass
class Dense:
    """Derivatives as a matrix."""

    matrix: Array

    def times(self, x: Array) -> Array:
        return np.asarray(self.matrix @ x)

    def transposed(self, weights: Array) -> Array:
        return np.asarray(self.matrix.T @ weights)

    def squared(self, weights: Array) -> Array:
        return np.asarray(self.matrix.T @ (weights[:, None] * self.matrix))


@dataclass
class Ball:
    """A smooth function within a ball and a random polytope around zero."""

    seed: int
    count: int = 6
    seen: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        self.goal = 3 * rng.normal(size=self.count)
        self.faces = rng.normal(size=(10, self.count))

    def value(self, x: Array) -> float:
        return float(np.sum((x - self.goal) ** 4) ** 0.5 + np.sum((x - self.goal) ** 2))

    def limits(self, x: Array) -> Array:
        return np.append(self.faces @ x - 1, x @ x - 4)

    def inside(self, x: Array) -> Inside:
        return Inside(self.value(x), self.limits(x))

    def point(self, x: Array) -> Point:
        self.seen.append(x)
        away = x - self.goal
        slope = 2 * away**3 / max(np.sum(away**4) ** 0.5, 1e-12) + 2 * away
        return Point(self.value(x), self.limits(x), x, slope, Dense(np.vstack([self.faces, 2 * x])))


@pytest.mark.parametrize("seed", range(10))
def test_it_ends_where_another_solver_does(seed: int) -> None:
    ball = Ball(seed)
    found = minimise(ball, np.zeros(ball.count), iterations=300)
    other = minimize(
        ball.value,
        np.zeros(ball.count),
        method="SLSQP",
        jac=lambda x: ball.point(x).gradient,
        constraints={"type": "ineq", "fun": lambda x: -ball.limits(x)},
        options={"maxiter": 500, "ftol": 1e-9},
    )
    assert (ball.limits(other.x) < 1e-6).all()
    assert found.value == pytest.approx(other.fun, rel=2e-3)
    assert found.value >= other.fun - 1e-5 * abs(other.fun)


@pytest.mark.parametrize("seed", range(5))
def test_all_points_on_the_way_are_inside(seed: int) -> None:
    ball = Ball(seed)
    minimise(ball, np.zeros(ball.count))
    assert len(ball.seen) > 5
    for x in ball.seen:
        assert (ball.limits(x) < 0).all()


def test_it_can_be_stopped_at_any_step() -> None:
    values: list[float] = []

    def enough(value: float) -> bool:
        values.append(value)
        return len(values) == 3

    ball = Ball(1)
    found = minimise(ball, np.zeros(ball.count), stop=enough)
    assert len(values) == 3
    assert found.value == values[-1] < ball.value(np.zeros(ball.count))
    assert found.holds


def test_a_start_outside_is_refused() -> None:
    with pytest.raises(ValueError, match="outside"):
        minimise(Ball(0), 10 * np.ones(6))


class Rounded(Dense):
    """Numbers so coarse that a sum of squares comes out negative."""

    def squared(self, weights: Array) -> Array:
        return np.asarray(-1e9 * np.eye(self.matrix.shape[1]))


@dataclass
class Corner(Ball):
    """The same function, from which no step can be found after a while."""

    flaw: str = ""

    def point(self, x: Array) -> Point:
        found = super().point(x)
        if self.flaw == "numbers are too coarse" and len(self.seen) > 3:
            return replace(found, jacobian=Rounded(np.vstack([self.faces, 2 * x])))
        return found

    def inside(self, x: Array) -> Inside:
        found = super().inside(x)
        if self.flaw == "nothing is better" and len(self.seen) > 3:
            return Inside(np.inf, found.limits)
        return found


@pytest.mark.parametrize("flaw", ["numbers are too coarse", "nothing is better"])
def test_where_there_is_no_step_the_last_point_is_the_answer(flaw: str) -> None:
    search = Corner(1, flaw=flaw)
    found = minimise(search, np.zeros(search.count))
    assert len(search.seen) == 4
    np.testing.assert_array_equal(found.x, search.seen[-1])
    assert found.holds
    assert found.value < search.value(np.zeros(search.count))
