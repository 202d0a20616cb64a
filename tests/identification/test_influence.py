"""What each parameter adds to the predicted signals, against signals computed one by one."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import testbed as tb
from testbed.identification.influence import by_influence, influence
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, robot, run_of


@pytest.mark.parametrize("name", ROBOTS)
def test_a_parameter_counts_for_the_signal_that_it_makes_alone(name: str) -> None:
    """Witness: the regressor of the motion, unfiltered, each column times its value."""
    tree = robot(name)
    recording = ideal(tree)
    found = run_of(tree, recording).estimates["external"]
    truth = found.minimal.values(tb.barycentric(tree))
    motion = tb.Motion(
        recording.time,
        recording.position,
        recording.measured("velocity"),
        recording.measured("acceleration"),
    )
    columns = tb.regressor(tree, motion, found.minimal) * truth
    whole = columns.sum(axis=2)
    shares = [
        np.linalg.norm(columns[:, part], axis=(0, 1)) / np.linalg.norm(whole[:, part])
        for part in (slice(0, 3), slice(3, 6))
    ]
    wanted = np.max(shares, axis=0)
    values = dict(zip(found.names, truth.tolist(), strict=True))
    got = influence(found, values)
    large = wanted > 0.02 * wanted.max()
    np.testing.assert_allclose(got[large], wanted[large], rtol=0.2)
    order = [n for n in by_influence([found], values) if n in np.array(found.names)[large]]
    ranks = [wanted[found.names.index(n)] for n in order]
    assert all(later < 1.5 * earlier for earlier, later in pairwise(ranks))


def test_a_parameter_of_nothing_comes_last_however_wrong_it_is() -> None:
    run = run_of(robot("ur5"))
    found = run.estimates["external"]
    name = by_influence([found], {})[0]
    wrong = replace(found, values=np.where(np.array(found.names) == name, 1e3, found.values))
    assert by_influence([wrong], {name: 0.0})[-1] == name
