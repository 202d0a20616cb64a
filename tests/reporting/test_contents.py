"""The report's rows of parameters: first what adds most to the predicted signals."""

from __future__ import annotations

import pytest

from testbed.identification.influence import by_influence
from testbed.reporting.contents import parameter_rows
from tests.helpers.runs import ROBOTS, robot, run_of


@pytest.mark.parametrize("name", ROBOTS)
def test_each_parameter_has_one_row_in_the_order_of_its_influence(name: str) -> None:
    run = run_of(robot(name))
    rows = parameter_rows(run)
    names = [row["name"] for row in rows]
    assert len(set(names)) == len(names)
    assert set(names) == {n for e in run.estimates.values() for n in e.names}
    assert names == by_influence(run.estimates.values(), run.truths)
    for row in rows:
        for cell in row["cells"]:
            estimate = run.estimates[cell["method"]]
            assert (cell["value"] is None) == (row["name"] not in estimate.names)
            if cell["value"] is not None:
                k = estimate.names.index(row["name"])
                assert row["unit"] == estimate.units[k]
                assert cell["value"] == estimate.values[k]
                assert cell["sigma"] == estimate.sigma[k]
