"""What a cure says is what the mapping must hold for the data to be without the mistake."""

from __future__ import annotations

import re
import tomllib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.sanity.cures import mistake_finding
from testbed.sanity.mistakes import Mistake, Signals
from tests.helpers.runs import robot

JOINTS = ("elbow", "waist", "shoulder")
"""The mapping's own order."""

READING: Any = SimpleNamespace(fit=SimpleNamespace(left=np.ones(3)))

TABLES: tuple[dict[str, Any], ...] = (
    {},
    {"sign": [1, -1, 1]},
    {"offset": [0.0, -1.5, 0.2]},
    {"sign": [-1, 1, -1], "offset": [0.3, 0.0, 0.0]},
)
MISTAKES = (
    Mistake("position_sign", (1,)),
    Mistake("position_sign", (0, 2)),
    Mistake("zero", (2,), (np.pi / 2,)),
    Mistake("zero", (0, 1), (-np.pi / 2, np.pi)),
)


def mapped(raw: Array, table: dict[str, Any]) -> Array:
    """Positions by the mapping, in the robot's order of joints; raw ones are in the mapping's."""
    values = raw * np.array(table.get("sign", [1.0] * 3)) + np.array(table.get("offset", [0.0] * 3))
    return np.asarray(values[:, [JOINTS.index(name) for name in robot("puma").names]])


@pytest.mark.parametrize("table", TABLES, ids=str)
@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mapping_with_its_cure_makes_the_data_right(
    mistake: Mistake, table: dict[str, Any]
) -> None:
    raw = np.random.default_rng(0).normal(size=(4, 3))
    mapping = {"joints": list(JOINTS), "position": table}
    found = mistake_finding(robot("puma"), mistake, READING, READING, mapping)
    changed = dict(table)
    for line in re.findall(r"\[position\] ([^;]*)", found.remedy):
        changed |= tomllib.loads(line)
    wanted = mistake.undone(Signals(mapped(raw, table), None, None)).position
    np.testing.assert_allclose(mapped(raw, changed), wanted, atol=1e-4)  # as it is printed


@pytest.mark.parametrize(
    ("joints", "said"), [((0, 1, 2), 'unit = "deg"'), ((0,), 'unit = ["rad", "deg", "rad"]')]
)
def test_a_unit_of_all_joints_is_said_once(joints: tuple[int, ...], said: str) -> None:
    mapping = {"joints": list(JOINTS), "position": {}}
    found = mistake_finding(robot("puma"), Mistake("degrees", joints), READING, READING, mapping)
    assert said in found.remedy
