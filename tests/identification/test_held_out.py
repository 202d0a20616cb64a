"""Choices by held-out data: terms that are there are added, and no others."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.identification.held_out import Parts, grown, stretches
from testbed.identification.term_choice import choose_terms
from testbed.robot.friction import QUADRATIC, ROTOR
from testbed.robot.shafts import with_shafts
from tests.helpers.ideal import ideal, plus
from tests.helpers.robots import random_robot


def some_rows(seed: int = 0) -> tuple[Array, Array]:
    """Seven columns, a measurement of the first, third and fourth, and noise."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(600, 7)) * np.geomspace(0.1, 100, 7)
    return x, x[:, [0, 2, 3]] @ np.array([10.0, 2.0, 0.1]) + rng.normal(size=600)


def parts_of(x: Array, y: Array, reach: int = 0) -> Parts:
    rows = np.column_stack([x, y])
    spans = list(stretches(len(rows), 6, reach))
    unseen = np.array([rows[own].T @ rows[own] for own, _ in spans])
    near = np.array([rows[beside].T @ rows[beside] for _, beside in spans])
    return Parts(unseen, rows.T @ rows - near)


@pytest.mark.parametrize("reach", [0, 7])
def test_what_is_left_is_what_plain_fits_leave(reach: int) -> None:
    """Of every row once, by rows that share no sample with it."""
    x, y = some_rows()
    found = parts_of(x, y, reach)
    for own in ([0], [0, 2], [0, 2, 3, 5]):
        for k, (part, beside) in enumerate(stretches(len(y), 6, reach)):
            seen = np.ones(len(y), bool)
            seen[beside] = False
            fit = np.linalg.lstsq(x[seen][:, own], y[seen], rcond=None)[0]
            left = float(np.sum((y[part] - x[part][:, own] @ fit) ** 2))
            assert found.left(own)[k] == pytest.approx(left, rel=1e-9)
    one_more = np.column_stack([found.left([0, 2, k]) for k in (1, 3, 5)])
    np.testing.assert_allclose(found.left_with([0, 2], [1, 3, 5]), one_more, rtol=1e-9)
    spans = list(stretches(101, 6, reach))
    assert np.concatenate([np.arange(101)[part] for part, _ in spans]).tolist() == list(range(101))
    for part, beside in spans:
        assert (beside.start, beside.stop) == (
            max(part.start - reach, 0),
            min(part.stop + reach, 101),
        )


def test_true_columns_are_added_and_no_others() -> None:
    for seed in range(10):
        x, y = some_rows(seed)
        chosen, how = grown(parts_of(x, y), [0], {k: k for k in range(1, 7)}, str)
        assert set(chosen[:2]) == {2, 3}
        assert len(chosen) <= 3  # two standard errors: one in forty by chance
        assert how.steps[2].residual < how.steps[0].residual
    x[:, 5], x[:, 6] = x[:, 0] - 2 * x[:, 2], 3 * x[:, 0]  # sums of others, at first or in the end
    for always, offered, count in (([0, 2], {5: 5, 6: 6}, 0), ([0], {2: 2, 5: 5, 6: 6}, 1)):
        chosen, how = grown(parts_of(x, y), always, offered, str)
        assert (len(chosen), len(how.steps), how.next_best) == (count, count + 1, None)


@pytest.mark.slow
def test_the_terms_of_a_made_up_robot_are_chosen() -> None:
    """A rotor here, quadratic friction there, and a shaft that rubs."""
    rng = np.random.default_rng(4)
    turning: list[int] = []
    while len(turning) < 2:
        tree = random_robot(rng, 4).tree()
        turning = [k for k, joint in enumerate(tree.joints) if joint.revolute][:2]
    tree = with_shafts(tree, {"shaft": {tree.names[k]: 1.0 for k in turning}})
    heavy, rough = np.eye(tree.n)[[tree.n - 1, 1]]
    recording = ideal(tree, 40.0, seed=4, own={ROTOR: 3.0 * heavy, QUADRATIC: 5.0 * rough})
    assert recording.velocity is not None
    speed = recording.velocity[:, turning].sum(axis=1)
    turn = np.isin(np.arange(tree.n), turning)
    rubs = (2.0 * np.sign(speed) + speed)[:, None] * turn
    noisy = plus(recording, torque=rubs + 0.05 * rng.normal(size=(recording.samples, tree.n)))
    found = choose_terms(tree, noisy, tb.Settings())
    assert found.after.rms < 0.3 * found.before.rms
    own = {f"quadratic/{tree.names[1]}", f"rotor/{tree.names[-1]}"}
    assert {"coulomb/shaft", "viscous/shaft", *own} <= set(found.words)
