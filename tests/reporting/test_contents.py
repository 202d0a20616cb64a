"""The report's rows of parameters: those of the joint torques, then those of the plate alone."""

from __future__ import annotations

import pytest

from testbed.reporting.contents import parameter_rows
from tests.helpers.runs import ROBOTS, robot, run_of


@pytest.mark.parametrize("name", ROBOTS)
def test_each_parameter_has_one_row_in_the_order_of_what_tells_it(name: str) -> None:
    run = run_of(robot(name))
    internal, external = run.estimates["internal"], run.estimates["external"]
    rows = parameter_rows(run)
    names = [row["name"] for row in rows]
    assert len(set(names)) == len(names)
    assert set(names) == {n for e in run.estimates.values() for n in e.names}
    torques = list(internal.base.names)
    assert names[: len(torques)] == torques
    plate = [n for n in external.names if n not in torques]
    assert names[len(torques) : len(torques) + len(plate)] == plate
    for row in rows:
        for cell in row["cells"]:
            estimate = run.estimates[cell["method"]]
            assert (cell["value"] is None) == (row["name"] not in estimate.names)
            if cell["value"] is not None:
                k = estimate.names.index(row["name"])
                assert row["unit"] == estimate.units[k]
                assert cell["value"] == estimate.values[k]
                assert cell["sigma"] == estimate.sigma[k]
